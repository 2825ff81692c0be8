"""``hmi-marl watch``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hmi_marl.envs.config import TeamSettings
from hmi_marl.envs.drivers import get_driver
from hmi_marl.files import make_folder

CLIP_FRAMES_PER_STEP = 2
WINDOW_FRAMES_PER_STEP = 6


@dataclass(frozen=True)
class Watch(TeamSettings):
    """Watch one episode: as a clip with --out, else in a window.

    Example: hmi-marl watch --driver homer --hmi optimal --out clip.gif
    """

    driver: str = "homer"
    """lisa, marge, bart, homer, average, name:beta,alpha,eta,inflation, or a driver file."""
    hmi: str = "optimal"
    """never, always, random[:RATE], when-distracted, optimal[:DRIVER], average, belief[:DRIVER],
    the folder of a trained run, trained:NAME, or mixture:NAME,NAME,... of these."""
    policy: str = "rule"
    """Driver policy: rule, random, the folder of a trained run, trained:NAME, or
    mixture:NAME,NAME,... of these."""
    seed: int = 0
    """Seed of the episode."""
    out: Path | None = None
    """A .gif, or an .mp4 with the video extra. Without it a window opens."""
    perceived: bool = False
    """Draw the other vehicles as large as the driver perceives them."""

    def run(self, command_line: str) -> None:
        """Play, and draw as it goes."""
        from hmi_marl.reporting import clip

        config = self.team(get_driver(self.driver))
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
