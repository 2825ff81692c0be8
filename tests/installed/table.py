"""Everything that the wheel promises to run, and the extras that each needs.

The arguments are those of the cheapest real run. ``test_table.py`` holds the rows against the code:
a new subcommand, option, example, block of the README or page without a row fails there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from made_parts import fill
from pages import PAGES, README, blocks
from test_examples import TINY

Kind = Literal["command", "option", "example", "readme", "page", "site"]

CORE: frozenset[str] = frozenset()
VIDEO, TRAIN, INTEROP, DATA, RAY, PEOPLE, DOCS = (
    frozenset({extra}) for extra in ("video", "train", "interop", "data", "ray", "people", "docs")
)


@dataclass(frozen=True)
class Row:
    """Something to run."""

    kind: Kind
    name: str
    """Subcommand, stem of the example, page, or words in one README block."""
    needs: frozenset[str]
    """Extras without which it does not run, and with which alone it does."""
    arguments: str = ""
    """Arguments of its cheapest real run."""
    before: Sequence[str] = ()
    """Commands that write what it reads."""
    prepared: Sequence[str] = ()
    """The same for commands that need more than it does: the Python of the tests runs them."""
    not_run: str = ""
    """Why no real run is made."""

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"


def _command(name: str, needs: frozenset[str], arguments: str = "", **others: object) -> Row:
    return Row("command", name, needs, arguments, **others)  # type: ignore[arg-type]


_SCENE = "--duration 2 --vehicles 1 3"
_RUN = "--num-teams 16 --duration 2"
_JUDGED = "--drivers 2 --population 2 --repeats 1 --candidates 1 --changes 2"
_CLIPS = (
    "study make --drivers bart lisa --controls --clips 2 --shown 1 --duration 1 --vehicles 1 2 "
    "--width 160 --policy rule"
)
STUDY_MADE = f"{_CLIPS} --format gif --out study"
_RATED = "study power study --raters 8 --studies 20 --out power"
_COLLECT = "collect --drivers lisa homer --steps 6400 --num-teams 64"
_LEARN = (
    "--pool 2 --num-teams 8 --held-out 0.5 --steps 800 --imitation-updates 1 --average-updates 1 "
    "--encoder-updates 1"
)
_ASSESS = "--windows 64 --episodes 2 --ranked 2"
_TRAITS = f"traits train --supervision id {_LEARN}"
_COMPARED = (
    "--tasks hidden --protocols two-stage joint --steps 640 --budgets 320 --seeds 1 --rounds 1 "
    "--driver-shares 0.5 --snapshots 1 --episodes 2 --cross-episodes 2 --drivers homer "
    f"--no-partners --no-crash-check --workers 1 {_RUN}"
)
_SWEPT = (
    "--over steps=160 num_teams=16 duration=2 --seeds 1 --episodes 2 --drivers homer --workers 1"
)


def _prefixed(prefix: str, options: str) -> str:
    return options.replace("--", f"--{prefix}.")


COMMANDS = (
    _command("adapt", CORE, f"{_JUDGED} --workers 1 --no-clip"),
    _command("bench", CORE, "--teams 1 --scaling 2 --seconds 0.05 --rounds 1 --threads 1"),
    _command("collect", DATA, "--drivers homer --steps 100 --num-teams 1"),
    _command("compare", TRAIN, _COMPARED),
    _command("export", TRAIN, "--policy trained:homer --out hmi.onnx"),
    _command("oracle", CORE, "--horizon 5"),
    _command("people delete", CORE, "people.db CODE", not_run="needs a person's code"),
    _command(
        "people export",
        CORE,
        "people.db",
        not_run="needs a database of people; tests/commands/test_people.py runs it without extras",
    ),
    _command(
        "people traits",
        CORE,
        "trips",
        not_run="needs recordings; tests/commands/test_people_traits.py runs it without extras",
    ),
    _command("play", PEOPLE, "--port 0", not_run="serves until a signal; see check_served"),
    _command("reproduce all", TRAIN | DATA, not_run="takes a quarter of an hour with --quick"),
    _command(
        "reproduce table",
        TRAIN,
        "--driver-steps 1600 --hmi-steps 1600 --episodes 2 --num-teams 16 --seeds 1 --workers 1",
    ),
    _command(
        "reproduce driver",
        TRAIN,
        "--steps 1600 --snapshots 1 --episodes 2 --num-teams 16 --seeds 1",
    ),
    _command(
        "reproduce hidden",
        TRAIN,
        "--driver-run trained:driver --hmi-steps 3200 --episodes 2 --num-teams 32 --seeds 1 "
        "--workers 1",
    ),
    _command(
        "reproduce adapt",
        TRAIN,
        "--drives 300 --updates 1 --strangers 2 --types 1 --rounds 1 --rnn-hidden-dim 2 --seeds 1 "
        "--workers 1 " + _prefixed("evaluation", _JUDGED),
    ),
    _command(
        "reproduce traits",
        TRAIN | DATA,
        "--driver-run trained:driver --demonstrated 6400 --strangers 4 --population 4 --seeds 1 "
        "--workers 1 "
        f"{_prefixed('learn', _LEARN)} {_prefixed('evaluation', _ASSESS)}",
    ),
    _command(
        "reproduce identify",
        TRAIN,
        "--driver-run trained:driver --driver-steps 1600 --num-teams 16 --windows 8 --strangers 3 "
        "--episodes 2 --workers 1",
    ),
    _command(
        "reproduce graded",
        TRAIN,
        "--hmi-steps 1600 --episodes 2 --num-teams 16 --seeds 1 --workers 1",
    ),
    _command(
        "reproduce map",
        CORE,
        "--windows 2 --shares 0.5 --etas 0.1 --horizon 3 --seen-cells 1 --hidden-cells 1 "
        "--points 2",
    ),
    _command(
        "reproduce shifts",
        DATA,
        "--driver-run trained:driver --shifts none rule-driver --fitted 3 --strangers 3 "
        "--posteriors 3 --windows 2 --sampling.groups 8 --sampling.rounds 1 "
        "--sampling.most-rounds 1 --workers 1",
    ),
    _command(
        "reproduce ablations",
        TRAIN | DATA,
        "--driver-run trained:driver --variants baseline loss-cosine --strangers 3 --judged 4 "
        "--named 24 --average-updates 1 --encoder-updates 1 --posteriors 0 --seeds 1 --workers 1",
    ),
    _command(
        "reproduce unsupervised",
        TRAIN | DATA,
        "--driver-run trained:driver --ways paper --demonstrated 16000 --steps 1 "
        "--imitation-updates 1 --seeds 1 --workers 1",
    ),
    _command("reproduce protocols", TRAIN, _COMPARED),
    _command("reproduce sweep", TRAIN | DATA, f"--protocols joint {_SWEPT}"),
    _command(
        "reproduce ship",
        CORE,
        "--out agents",
        not_run="copies what a whole hmi-marl reproduce has learned",
    ),
    _command("study make", CORE, _CLIPS.removeprefix("study make ") + " --format gif"),
    _command(
        "study serve", PEOPLE, "study people.db", not_run="serves until a signal; see check_served"
    ),
    _command(
        "study analyse", PEOPLE, "study power/answers-simulated.csv", before=(STUDY_MADE, _RATED)
    ),
    _command("study power", CORE, _RATED.removeprefix("study power "), before=(STUDY_MADE,)),
    _command("sweep", TRAIN | DATA, f"joint {_SWEPT}"),
    _command("table", CORE, f"--drivers homer --hmis NoHMI own --episodes 2 --workers 1 {_SCENE}"),
    _command("train two-stage", TRAIN, f"--driver-steps 160 --hmi-steps 160 {_RUN}"),
    _command("train joint", TRAIN, f"--steps 160 {_RUN}"),
    _command("train simultaneous", TRAIN, f"--steps 160 {_RUN}"),
    _command("train alternating", TRAIN, f"--driver-steps 160 --hmi-steps 160 --rounds 1 {_RUN}"),
    _command(
        "train fine-tune",
        TRAIN,
        f"--driver-steps 160 --hmi-steps 160 --together-steps 160 {_RUN}",
    ),
    _command("traits train", TRAIN | DATA, f"--supervision id {_LEARN}", before=(_COLLECT,)),
    _command(
        "traits evaluate",
        DATA,
        f"runs/traits-id {_ASSESS}",
        prepared=(_COLLECT, _TRAITS),
    ),
    _command(
        "traits posterior",
        DATA,
        "--cases seen-unknown --windows 1 --seconds 5 --sampling.groups 16",
        before=("collect --drivers --population 4 --windows 1 --num-teams 4",),
    ),
    _command("watch", CORE, f"--out clip.gif {_SCENE}"),
)
"""Every subcommand that can be run, once."""

OPTIONS = (
    Row("option", "collect --minari", DATA, "--drivers homer --steps 100 --num-teams 1 --minari"),
    Row("option", "compare --ray", TRAIN | RAY, f"{_COMPARED} --ray local"),
    Row(
        "option",
        "people export --formats parquet",
        DATA,
        "people.db --formats parquet",
        not_run="see people export",
    ),
    Row(
        "option",
        "people export --formats minari",
        DATA,
        "people.db --formats minari",
        not_run="see people export",
    ),
    Row("option", "study make --format mp4", VIDEO, _CLIPS.removeprefix("study make ")),
    Row("option", "sweep --ray", TRAIN | DATA | RAY, f"joint {_SWEPT} --ray local"),
    *(
        Row(
            "option",
            f"{row.name} --ray",
            row.needs | RAY,
            "--ray local",
            not_run="trains as compare --ray does",
        )
        for row in COMMANDS
        if row.name.startswith("reproduce ") and row.name != "reproduce ship"
    ),
    Row("option", "watch --out clip.mp4", VIDEO, f"--out clip.mp4 {_SCENE}"),
)
"""Options that need more than their subcommand does, or another part of an extra."""

EXAMPLES = tuple(
    Row("example", name, needs, " ".join(TINY[name][0]))
    for name, needs in {
        "turn_taking": CORE,
        "new_driver": CORE,
        "new_experiment": CORE,
        "new_hmi": CORE,
        "new_protocol": TRAIN,
        "new_world": CORE,
        "unknown_driver": CORE,
        "policy_gradient_hmi": TRAIN,
        "latent_traits": TRAIN | DATA,
        "supersuit_vector": INTEROP,
        "sb3_parameter_sharing": INTEROP,
    }.items()
)
"""Every example, at the size at which make test runs it."""

README_BLOCKS = (
    Row("readme", "agent_iter(", CORE),
    Row("readme", 'layout("vehicle_ai")', CORE),
    Row("readme", "hmi_marl/MergeHMI-v0", CORE),
    Row("readme", "oracle.solve_alerts(", CORE),
    Row("readme", "hmi_marl.make_vec(", TRAIN),
)
"""Every block of Python of the README, by words that are in it alone."""

SITE_PAGES = tuple(
    Row("page", name, needs, prepared=prepared)
    for name, (needs, *prepared) in {
        "adapting.md": (CORE,),
        "custom-trainers.md": (TRAIN | INTEROP,),
        "demonstrations.md": (DATA, "collect --drivers homer --steps 4802 --duration 0.4"),
        "environment.md": (CORE,),
        "exact.md": (CORE,),
        "extending.md": (CORE,),
        "graded-alerts.md": (CORE,),
        "index.md": (CORE,),
        "people.md": (CORE,),
        "settings.md": (CORE,),
        "training.md": (TRAIN,),
        "traits.md": (DATA, _COLLECT, _TRAITS),
        "when-the-driver-matters.md": (CORE,),
    }.items()
)
"""Every page with blocks of Python, which are one program from top to bottom, and the commands that
write what it reads."""

ROWS = (
    *COMMANDS,
    *OPTIONS,
    *EXAMPLES,
    *README_BLOCKS,
    *SITE_PAGES,
    Row("site", "docs/making", DOCS),
)


def readme_block(row: Row) -> str:
    """The block of the README that a row names.

    Raises:
        ValueError: no block has the row's words, or several have them.
    """
    found = [block for block in blocks(README.read_text("utf-8"), "python") if row.name in block]
    if len(found) != 1:
        raise ValueError(f"{row.name!r} is in {len(found)} blocks of the README, not in one")
    return found[0]


def page_programs() -> Iterator[tuple[str, str]]:
    """Name and program of every page that has blocks of Python."""
    for page in PAGES:
        found = blocks(fill(page.read_text("utf-8")), "python")
        if found:
            yield page.name, "\n\n".join(found)
