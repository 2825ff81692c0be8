"""Clips of an episode, and live windows."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from functools import partial
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from hmi_marl.agents.adaptive.hmis import AdaptiveHMI
from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.rollout import HandsOver, Observer, begin, turns
from hmi_marl.agents.signals import SignalWatch
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Traits
from hmi_marl.envs.render import TeamStatus, Viewer, between, team_status
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.streams import check_seed
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import Snapshot
from hmi_marl.extras import need
from hmi_marl.files import write_atomically

Pictures = Iterator[NDArray[np.uint8]]
"""Each of shape (height, width, 3)."""

SUFFIXES = (".gif", ".mp4")
GIF_COLOURS = 64
NO_HOLDS: Mapping[int, float] = MappingProxyType({})


def episode(
    config: TeamConfig, hmi: str, driver_policy: str, seed: int, world: str = "highway"
) -> Iterator[tuple[Snapshot, TeamStatus]]:
    """Play one episode sequentially, policies by name; yields each moment, the first included.

    Raises:
        ValueError: an unknown name or a bad seed; at once, before the first moment.
    """
    driver, ai = make_driver_policy(driver_policy, config), make_hmi(hmi, config)
    teaming = begin(config, driver, ai, np.array([check_seed(seed)], np.uint64), world)
    return moments(teaming, driver, ai)


def moments(
    teaming: Teaming, driver: Policy, ai: Policy, hand_over: tuple[int, Traits] | None = None
) -> Iterator[tuple[Snapshot, TeamStatus]]:
    """Play an episode of one team that has begun; see :func:`episode`.

    In step ``hand_over[0]``, if given, a driver with these traits takes the wheel. Where attention
    is hidden and the driver stays and is known, the moments hold the exact belief about d.
    """
    observers: list[Observer] = [] if hand_over is None else [HandsOver(*hand_over)]
    watch = None
    if not (teaming.config.ai_sees_attention or hand_over or isinstance(ai, AdaptiveHMI)):
        watch = SignalWatch()  # the belief of an HMI that knows the driver
        observers.append(watch)
    yield _moment(teaming, ai, watch)
    for _ in turns(teaming, driver, ai, observers):
        yield _moment(teaming, ai, watch)


def _moment(teaming: Teaming, ai: Policy, watch: SignalWatch | None) -> tuple[Snapshot, TeamStatus]:
    status = team_status(teaming, 0)
    if isinstance(ai, AdaptiveHMI):
        named = ai.estimator.belief.named()
        status = replace(status, belief=tuple((name, float(p[0])) for name, p in named.items()))
    if watch is not None:
        now = watch.signal
        shown, belief = (False, 0.0) if now is None else (bool(now.reveals[0]), now.belief[0])
        status = replace(status, reveals=shown, distracted_belief=float(belief))
    return teaming.world.snapshot(0), status


def frames(shown: Iterator[tuple[Snapshot, TeamStatus]], viewer: Viewer, per_step: int) -> Pictures:
    """Draw an episode, ``per_step`` pictures for each policy step, with positions in between."""
    before, status = next(shown)
    yield viewer.draw(before, status, per_step)
    for after, status in shown:
        for k in range(1, per_step + 1):
            yield viewer.draw(between(before, after, k / per_step), status, per_step)
        before = after


def show(
    config: TeamConfig,
    moments: Iterator[tuple[Snapshot, TeamStatus]],
    per_step: int,
    perceived: bool = False,
) -> None:
    """Play an episode in a window, in real time, until it ends or the window is closed.

    Raises:
        RuntimeError: there is no display.
    """
    with closing(Viewer(config, window=True, perceived=perceived)) as viewer:
        for _ in frames(moments, viewer, per_step):
            if viewer.closed:
                return


def record(
    path: Path,
    config: TeamConfig,
    moments: Iterator[tuple[Snapshot, TeamStatus]],
    per_step: int,
    perceived: bool = False,
    progress: Callable[[Pictures], Pictures] = iter,
    holds: Mapping[int, float] = NO_HOLDS,
) -> None:
    """Write an episode as a clip: a .gif, or an .mp4 with the video extra.

    Args:
        path, config: file of the clip, and settings of the team.
        moments: from :func:`episode`.
        per_step: pictures for each policy step.
        perceived: draw the other objects' perceived sizes.
        progress: receives the pictures and passes them on, one by one.
        holds: duration for which the clip stands still [s], by the number of the moment from 0 on.
    """
    check_suffix(path)
    pictures = frames(moments, Viewer(config, perceived=perceived), per_step)
    still = {per_step * moment: seconds for moment, seconds in holds.items()}
    write_clip(path, progress(pictures), config.scene.policy_frequency * per_step, still)


def as_gif(
    config: TeamConfig, moments: Iterator[tuple[Snapshot, TeamStatus]], per_step: int = 1
) -> bytes:
    """Draw an episode as the content of a GIF."""
    content = BytesIO()
    pictures = frames(moments, Viewer(config), per_step)
    _write_gif(content, pictures, config.scene.policy_frequency * per_step, NO_HOLDS)
    return content.getvalue()


def check_suffix(path: Path) -> Path:
    """Return ``path`` if it names a clip that can be written, else raise."""
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"a clip is a {' or '.join(SUFFIXES)} file, not {path.name!r}")
    if path.suffix.lower() == ".mp4":
        try:
            need("an mp4 clip", "imageio_ffmpeg")
        except ModuleNotFoundError as error:
            raise RuntimeError(f"{error}; or write a .gif") from None
    return path


def write_clip(
    path: Path, pictures: Pictures, frequency: float, holds: Mapping[int, float] = NO_HOLDS
) -> None:
    """Write one or more pictures (height, width, 3) as GIF or MP4, by suffix; frequency in Hz.

    A picture is shown instead for the time in ``holds`` [s], by its number from 0 on.
    """
    write = _write_gif if check_suffix(path).suffix.lower() == ".gif" else _write_mp4
    write_atomically(path, partial(write, pictures=pictures, frequency=frequency, holds=holds))


def _write_gif(
    file: Path | BytesIO, pictures: Pictures, frequency: float, holds: Mapping[int, float]
) -> None:
    first, *rest = (
        Image.fromarray(picture).quantize(GIF_COLOURS, dither=Image.Dither.NONE)
        for picture in pictures
    )
    # GIF counts in hundredths of a second.
    pauses = [10 * round(100 * holds.get(k, 1 / frequency)) for k in range(1 + len(rest))]
    duration = pauses[0] if len(set(pauses)) == 1 else pauses
    how: dict[str, Any] = {"duration": duration, "loop": 0, "optimize": True}
    first.save(file, "GIF", save_all=True, append_images=rest, **how)


def _write_mp4(
    path: Path, pictures: Pictures, frequency: float, holds: Mapping[int, float]
) -> None:
    import imageio_ffmpeg

    first = next(pictures)
    height, width, _ = first.shape
    size = width, height
    writer = imageio_ffmpeg.write_frames(str(path), size, fps=frequency, macro_block_size=2)
    with closing(writer):
        writer.send(None)
        for k, picture in enumerate(itertools.chain([first], pictures)):
            for _ in range(max(1, round(frequency * holds.get(k, 0.0)))):
                writer.send(np.ascontiguousarray(picture))
