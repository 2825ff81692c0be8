"""``hmi-marl watch``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hmi_marl.envs.alerts import FULL
from hmi_marl.envs.config import TeamConfig, as_fatigue
from hmi_marl.envs.drivers import get_driver
from hmi_marl.envs.scene import Scene
from hmi_marl.files import make_folder

CLIP_FRAMES_PER_STEP = 2
WINDOW_FRAMES_PER_STEP = 6


@dataclass(frozen=True)
class Watch:
    """Watch one episode: as a clip with --out, else in a window.

    Example: hmi-marl watch --driver homer --hmi optimal --out clip.gif
    """

    driver: str = "homer"
    """lisa, marge, bart, homer, average, or name:beta,alpha,eta,inflation."""
    hmi: str = "optimal"
    """never, always, random[:RATE], when-distracted, optimal[:DRIVER], average, belief[:DRIVER],
    the folder of a trained run, or trained:NAME."""
    policy: str = "rule"
    """Who steers: rule, random, the folder of a trained run, or trained:NAME."""
    seed: int = 0
    """Of the episode."""
    out: Path | None = None
    """A .gif, or an .mp4 with the video extra. Without it a window opens."""
    perceived: bool = False
    """Draw the other vehicles as large as the driver perceives them."""
    hide_attention: bool = False
    """The HMI does not see whether the driver is distracted."""
    alert_window: int = 7
    """N, for how many steps an alert stays in effect."""
    alert_strengths: tuple[float, ...] = FULL
    """Strengths of alert that the HMI can choose from, rising within (0, 1]."""
    fatigue: tuple[int, int, float] | None = None
    """LEVELS PER_ALERT EFFECT, how alerts that pile up lose their effect, for example 10 2 0.5;
    they do not by default."""
    end_at_crash: bool = True
    """Whether a crash ends the episode."""
    vehicles: tuple[int, int] = (1, 20)
    """Least and most other vehicles."""
    duration: float = 20.0
    """Length of the episode [s]."""

    def run(self, command_line: str) -> None:
        """Play, and draw as it goes."""
        from hmi_marl.reporting import clip

        config = TeamConfig(
            driver=get_driver(self.driver),
            ai_sees_attention=not self.hide_attention,
            alert_window=self.alert_window,
            alert_strengths=self.alert_strengths,
            fatigue=as_fatigue(self.fatigue),
            end_at_crash=self.end_at_crash,
            duration=self.duration,
            scene=Scene(vehicles=self.vehicles),
        )
        moments = clip.episode(config, self.hmi, self.policy, self.seed)
        if self.out is None:
            clip.show(config, moments, WINDOW_FRAMES_PER_STEP, self.perceived)
            return
        make_folder(clip.check_suffix(self.out).parent)
        from tqdm import tqdm

        total = config.horizon * CLIP_FRAMES_PER_STEP + 1
        with tqdm(total=total, unit=" frames", desc=self.out.name) as bar:

            def counted(pictures: clip.Pictures) -> clip.Pictures:
                for picture in pictures:
                    bar.update()
                    yield picture

            clip.record(self.out, config, moments, CLIP_FRAMES_PER_STEP, self.perceived, counted)
        print(f"written: {self.out}")
