"""Experiment "shifts": what z and exact posteriors say of traits when something has shifted.

Nothing is learned but the probes that read traits from z, on strangers without shift, as a user of
a trait model would have them. The same strangers are recorded again under each shift.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated

from hmi_marl.agents.learned.policy import load_policy
from hmi_marl.agents.learned.trait_model import load_traits
from hmi_marl.checks import Names, Whole
from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.envs.config import DRIVER, TeamConfig
from hmi_marl.envs.streams import Seed, part_seed
from hmi_marl.exact.importance import Sampling
from hmi_marl.experiments.experiment import Place
from hmi_marl.experiments.trait_shifts.errors import ShiftRow, shift_row
from hmi_marl.experiments.trait_shifts.report import READERS, ShiftsReport
from hmi_marl.experiments.trait_shifts.scoring import (
    KNOWING,
    UNAWARE,
    Estimates,
    Inference,
    Part,
    Probing,
    has_probabilities,
    score,
)
from hmi_marl.experiments.trait_shifts.shifts import (
    NONE,
    SHIFTS,
    Shift,
    knowing_belief,
    unshifted_belief,
)
from hmi_marl.workers import calls

PARTS = "parts"
"""Folder of what has been found, below that of the experiment."""
_NAMES = tuple(shift.name for shift in SHIFTS)
_FITTED_PART = 2**32 + 4
"""Part of the experiment's seed."""


@dataclass(frozen=True)
class TraitShifts(ShiftsReport):
    """Compare what z and exact posteriors say of traits when drivers, HMIs or traits shift.

    Raises:
        ValueError: too few strangers, more posteriors than strangers, or an unknown shift.
    """

    traits_model: str = "trained:traits-self"
    """Trait model: the folder of a run of hmi-marl traits train, or trained:NAME."""
    shifts: Annotated[tuple[str, ...], Names(_NAMES, NONE.name)] = _NAMES
    """Shifts by name."""
    fitted: Annotated[int, Whole(3, 100_000)] = 300
    """Strangers without shift on whom the probes are fitted."""
    strangers: Annotated[int, Whole(3, 100_000)] = 300
    """Other strangers, whose traits are read from z, the same ones under each shift."""
    posteriors: Annotated[int, Whole(3, 100_000)] = 24
    """The first of these, whose exact posteriors are computed."""
    windows: Annotated[int, Whole(2, 1000)] = 8
    """Windows of 20 s of each stranger, which are read together."""
    sampling: Sampling = field(default_factory=Sampling)
    """Points of the posteriors."""
    seed: Seed = 0
    """Seed of all draws."""

    uses_driver = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.posteriors > self.strangers:
            raise ValueError(
                f"posteriors are of the strangers, {self.strangers} at most, not {self.posteriors}"
            )

    @classmethod
    def quick(cls) -> TraitShifts:
        """See :meth:`Experiment.quick`."""
        some = (NONE.name, "control-driver", "average-hmi", "drift-large", "high-inflation")
        few = Sampling(32, 4, most_rounds=8, effective=30)
        return cls(shifts=some, fitted=100, strangers=100, posteriors=3, sampling=few)

    def check(self, place: Place) -> None:
        """See :meth:`Experiment.check`."""
        super().check(place)
        load_policy(place.driver_run, DRIVER, TeamConfig())
        load_traits(self.traits_model)

    @property
    def chosen(self) -> list[Shift]:
        """Shifts, in the order of the tables."""
        return [shift for shift in SHIFTS if shift.name in self.shifts]

    def base(self, place: Place, population: int) -> CollectSettings:
        """Settings of a recording of strangers without shift."""
        return CollectSettings(
            drivers=(),
            population=population,
            windows=self.windows,
            driver_policy=str(place.driver_run),
            num_teams=population * self.windows,
            seed=self.seed,
        )

    def parts(self, shift: Shift, place: Place) -> dict[str, Part]:
        """Return what has to be computed for a shift, by name."""
        base, few = (self.base(place, count) for count in (self.strangers, self.posteriors))
        fitted = replace(
            self.base(place, self.fitted), seed=int(part_seed(self.seed, _FITTED_PART))
        )
        recording = shift.recording(few)
        unaware = unshifted_belief(few, recording)
        parts: dict[str, Part] = {
            "z": Probing(self.traits_model, fitted, shift.recording(base), self.seed),
            UNAWARE: Inference(recording, unaware, UNAWARE, self.sampling, self.seed),
        }
        known = knowing_belief(recording, has_probabilities(recording.driver_policy))
        if known is not None and known != unaware:
            parts[KNOWING] = Inference(recording, known, KNOWING, self.sampling, self.seed)
        return parts

    def run(self, place: Place) -> list[ShiftRow]:
        """Record and read what is not read yet."""
        todo = [
            (part, place.folder / PARTS / f"{shift.name}-{name}.json", shift.name)
            for shift in self.chosen
            for name, part in self.parts(shift, place).items()
        ]
        todo.sort(key=lambda each: isinstance(each[0], Inference))  # the short ones first
        found: dict[str, dict[str, Estimates]] = {shift.name: {} for shift in self.chosen}
        tasks = [(part, path) for part, path, _ in todo]
        with place.playing(len(tasks), "parts") as progress:
            for (_, _, name), each in zip(todo, calls(score, tasks, place.workers), strict=True):
                found[name] |= each
                progress(1)
        return [self._row(shift, place, found) for shift in self.chosen]

    def _row(self, shift: Shift, place: Place, found: dict[str, dict[str, Estimates]]) -> ShiftRow:
        few = self.base(place, self.posteriors)
        recording = shift.recording(few)
        own, unshifted = found[shift.name], found[NONE.name]
        for each, of in ((unshifted, few), (own, recording)):
            known = knowing_belief(of, has_probabilities(of.driver_policy))
            if known is not None:  # the same posterior, if what has shifted is seen
                each.setdefault(KNOWING, each[UNAWARE])
        return shift_row(shift.name, shift.what, own, unshifted, tuple(READERS))
