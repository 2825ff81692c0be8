"""Files that the package reads, each with its reader and a way to alter it.

A case named ``signed_...`` alters a file and then puts the right checksum of what it is now into
it, so that what lies behind the checksum is tried too.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from demonstrations import made_up
from evidence_models import untrained_evidence
from model_cards import with_weights
from mutations import contents, hostile, hostile_json
from parquet_files import write_signed
from people.study.studies import a_study
from people.trips import a_trip
from trait_models import save_driver, untrained

from hmi_marl.agents.adaptive.evidence_model import load_evidence, save_evidence
from hmi_marl.agents.learned.cards import INDEX_FORMAT, find_shipped, shipped_agents
from hmi_marl.agents.learned.policy import read_policy
from hmi_marl.agents.learned.trait_model import load_traits, save_traits
from hmi_marl.demonstrations.env import env_spec, team_of
from hmi_marl.demonstrations.parquet import (
    OBSERVED,
    TRUTH,
    read_demonstrations,
    write_demonstrations,
)
from hmi_marl.envs.driver_files import write_driver
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.experiments.driver_map.cases import Case as MapCase
from hmi_marl.experiments.driver_map.cases import CaseResult, Grid, Integral, Loss
from hmi_marl.experiments.driver_map.experiment import read_result
from hmi_marl.experiments.episode_sums import Sums
from hmi_marl.experiments.protocols.kept import Kept
from hmi_marl.files import json_value, with_checksum, without_checksum
from hmi_marl.people.measure.trip_files import measurable, read_trips
from hmi_marl.people.record import TripRecord
from hmi_marl.people.store import Store
from hmi_marl.people.study.folder import read_study
from hmi_marl.people.study.ratings import read_ratings, write_answers
from hmi_marl.people.study.settings import Plan
from hmi_marl.people.study.simulated import simulated_answers
from hmi_marl.reading import read_json
from hmi_marl.reporting.blocks import Table, Text, Verdicts, block_from
from hmi_marl.reporting.statistics import mean
from hmi_marl.reporting.verdicts import Part, Verdict
from hmi_marl.reproduction import suite
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.checkpoint import Checkpoint
from hmi_marl.training.runs.folder import read_curve, read_settings, run_settings, settings_digest
from hmi_marl.training.traits.windows import read_preferences


@dataclass(frozen=True)
class Case:
    """A file with its reader."""

    path: Path
    read: Callable[[], object]
    mutate: Callable[[int], object]
    checked: bool = False
    """Whether a checksum covers the whole file, so that nothing else may be read than was written.
    """

    def original(self) -> object:
        """Read the file as it is, and return what must be read; None for anything that fits."""
        found = contents(self.read())
        return found if self.checked else None


def bytes_of(path: Path, read: Callable[[], object], checked: bool = False) -> Case:
    """Mutate the bytes of a file."""
    content = path.read_bytes()
    return Case(path, read, lambda seed: path.write_bytes(hostile(content, seed)), checked)


def json_of(path: Path, read: Callable[[], object], checked: bool = False) -> Case:
    """Mutate a JSON file, by its values or its bytes."""
    content = path.read_bytes()
    value = json.loads(content)

    def mutate(seed: int) -> None:
        text = hostile_json(value, seed).encode() if seed % 3 else hostile(content, seed)
        path.write_bytes(text)

    return Case(path, read, mutate, checked)


def signed_json(path: Path, read: Callable[[], object]) -> Case:
    """Mutate the values of a JSON file with a checksum, and put the right one into it."""
    content = without_checksum(json.loads(path.read_bytes()))

    def mutate(seed: int) -> None:
        text = hostile_json(content, seed)
        with suppress(ValueError, RecursionError):
            text = json.dumps(with_checksum(json.loads(text)))
        path.write_text(text)

    return Case(path, read, mutate)


def bytes_of_either(first: Path, second: Path, read: Callable[[], object]) -> Case:
    """Mutate the bytes of one of two files, both of which are checked by their whole content."""
    content = {path: path.read_bytes() for path in (first, second)}

    def mutate(seed: int) -> None:
        for turn, (path, before) in enumerate(content.items()):
            path.write_bytes(hostile(before, seed) if seed % 2 == turn else before)

    return Case(first, read, mutate, checked=True)


def signed_weights(card: Path, read: Callable[[], object]) -> Case:
    """Mutate weights, with the right checksum of what they are now in the card."""
    path = card.with_suffix(".safetensors")
    content = path.read_bytes()

    def mutate(seed: int) -> None:
        changed = hostile(content, seed) if seed % 2 else hostile_header(content, seed)
        with_weights(card, changed)

    return Case(path, read, mutate)


def hostile_header(content: bytes, seed: int, inner: str | None = None) -> bytes:
    """Mutate the JSON header of a safetensors file, or JSON within its metadata."""
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    if inner is None:
        text = hostile_json(header, seed).encode()
    else:
        within = hostile_json(json.loads(header["__metadata__"][inner]), seed)
        header["__metadata__"][inner] = within
        text = json.dumps(header, separators=(",", ":")).encode()
    return len(text).to_bytes(8, "little") + text + content[8 + size :]


def hostile_tensors(content: bytes, seed: int, inner: str) -> bytes:
    """Change a safetensors file: its bytes, its header, or the JSON in its metadata."""
    way = seed % 3
    if way == 0:
        return hostile(content, seed)
    return hostile_header(content, seed, inner if way == 1 else None)


def driver_card(folder: Path) -> Path:
    save_driver(folder)
    return folder / "driver.json"


def policy(folder: Path) -> Case:
    card = driver_card(folder)
    return json_of(card, lambda: read_policy(card), checked=True)


def policy_bytes(folder: Path) -> Case:
    card = driver_card(folder)
    return bytes_of_either(card, card.with_suffix(".safetensors"), lambda: read_policy(card))


def signed_policy(folder: Path) -> Case:
    card = driver_card(folder)
    return signed_json(card, lambda: read_policy(card))


def signed_policy_weights(folder: Path) -> Case:
    card = driver_card(folder)
    return signed_weights(card, lambda: read_policy(card))


def traits_card(folder: Path) -> Path:
    model = untrained(made_up([3]).observed.layout)
    return save_traits(folder, model.card, model.weights)


def read_traits(folder: Path) -> object:
    model = load_traits(folder)
    return model.card, model.weights


def traits(folder: Path) -> Case:
    return json_of(traits_card(folder), lambda: read_traits(folder), checked=True)


def signed_traits(folder: Path) -> Case:
    return signed_json(traits_card(folder), lambda: read_traits(folder))


def evidence_card(folder: Path) -> Path:
    model = untrained_evidence()
    return save_evidence(folder, model.card, model.weights)


def read_evidence(folder: Path) -> object:
    model = load_evidence(folder)
    return model.card, model.weights


def evidence(folder: Path) -> Case:
    return json_of(evidence_card(folder), lambda: read_evidence(folder), checked=True)


def signed_evidence(folder: Path) -> Case:
    return signed_json(evidence_card(folder), lambda: read_evidence(folder))


def index_file(folder: Path) -> Path:
    save_driver(folder / "mine")
    files = {
        f"mine/{name}": hashlib.sha256((folder / "mine" / name).read_bytes()).hexdigest()
        for name in ("driver.json", "driver.safetensors")
    }
    agents = {"mine": {"what": "a driver", "kind": "driver", "files": files}}
    path = folder / "INDEX.json"
    about = {"format": INDEX_FORMAT, "version": "1", "agents": agents}
    path.write_text(json.dumps(with_checksum(about)))
    return path


def read_index(folder: Path) -> object:
    agents = shipped_agents(folder)
    for agent in agents.values():
        assert agent.card.endswith(".json")
    return agents, find_shipped("trained:mine", "driver", folder)


def index(folder: Path) -> Case:
    return json_of(index_file(folder), lambda: read_index(folder), checked=True)


def signed_index(folder: Path) -> Case:
    return signed_json(index_file(folder), lambda: read_index(folder))


def checkpoint_file(folder: Path) -> tuple[Path, str]:
    path, settings = folder / "checkpoint.safetensors", settings_digest({"settings": {"seed": 1}})
    rows = [{"phase": "driver", "steps": 80, "return": 0.5}] * 3
    tensors = {"driver": {"actor.weight": torch.ones(4, 3), "optimizer.0.step": torch.ones(())}}
    Checkpoint(1, 2, 3, 4.0, tensors, rows, settings).save(path)
    return path, settings


def checkpoint(folder: Path) -> Case:
    path, settings = checkpoint_file(folder)
    return bytes_of(path, lambda: Checkpoint.load(path, settings, 2), checked=True)


def signed_checkpoint(folder: Path) -> Case:
    """Mutate a checkpoint, with the right checksum of what it is now."""
    path, settings = checkpoint_file(folder)
    content = path.read_bytes()
    at = content.index(b'sha256\\": \\"') + len(b'sha256\\": \\"')
    digest = content[at : at + 64]

    def mutate(seed: int) -> None:
        changed = hostile_tensors(content, seed, "hmi_marl")
        found = hashlib.sha256(changed.replace(digest, b"0" * 64, 1)).hexdigest().encode()
        path.write_bytes(changed.replace(digest, found, 1))

    return Case(path, lambda: Checkpoint.load(path, settings, 2), mutate)


def settings_file(folder: Path) -> Case:
    """Mutate a run's settings: its checkpoint, which holds their digest, is read or refused."""
    path, checkpoint = folder / "run.json", folder / "checkpoint.safetensors"
    about = {"version": "1", "settings": run_settings(TwoStage()), "command": "hmi-marl train"}
    path.write_text(json.dumps(about))
    Checkpoint(1, 2, 3, 4.0, settings=settings_digest(about)).save(checkpoint)

    def read() -> object:
        return Checkpoint.load(checkpoint, settings_digest(read_settings(path)), 2)

    return json_of(path, read, checked=True)


def curve(folder: Path) -> Case:
    rows = [{"phase": "driver", "steps": 80 * k, "return": 0.5, "seconds": 1.0} for k in range(3)]
    (folder / "curve.json").write_text(json.dumps(rows))
    return json_of(folder / "curve.json", lambda: read_curve(folder))


def preferences(folder: Path) -> Case:
    path = folder / "answers.json"
    path.write_text(json.dumps({"ada": 0.5, "bob": 1}))
    return json_of(path, lambda: read_preferences(path))


def block(folder: Path) -> Case:
    path = folder / "report.json"
    parts = (Part.exact("x", 1.0, above=0.0), Part.mean("y", mean([1.0, 2.0]), "runs", below=9.0))
    verdicts = Verdicts([Verdict("it holds", parts, "1 > 0", "2.1")])
    blocks = [Text("a", "b"), Table("t", ["", "x"], [["y", "1"]]), verdicts]
    path.write_text(json.dumps([each.as_json() for each in blocks]))

    def read() -> None:
        content = suite.read_json(path)
        if not isinstance(content, list):
            raise ValueError("no list of blocks")
        for each in content:
            read_block = block_from(each)
            read_block.as_text()
            read_block.as_html()

    return json_of(path, read)


def record_file(folder: Path) -> Path:
    path = folder / "one.json"
    content = {"stage": "one", "numbers": {"mean": 0.5}, "blocks": [Text("a").as_json()]}
    path.write_text(json.dumps(with_checksum(content)))
    return path


def record(folder: Path) -> Case:
    """Mutate a stage's record."""
    path = record_file(folder)
    return json_of(path, lambda: suite._read(path), checked=True)


def signed_record(folder: Path) -> Case:
    path = record_file(folder)
    return signed_json(path, lambda: suite._read(path))


def map_file(folder: Path) -> Path:
    path = folder / "case.json"
    loss = Loss(*[Integral(0.5, 0.1)] * 3, 2.0, (0.1, 0.2, 0.3), {"lisa": 1.0}, (((0.5,),),))
    result = CaseResult(MapCase(7, "paper", 10, 0.35), Grid(1, 2, (0.1,)), {"average": loss})
    content = {"about": {"version": "1"}, "result": json_value(result)}
    path.write_text(json.dumps(with_checksum(content)))
    return path


def map_case(folder: Path) -> Case:
    """Mutate a case of the map of when the driver matters."""
    path = map_file(folder)
    return json_of(path, lambda: read_result(path), checked=True)


def signed_map_case(folder: Path) -> Case:
    path = map_file(folder)
    return signed_json(path, lambda: read_result(path))


def dataset(folder: Path) -> Path:
    made = made_up([4, 2, 3], crash_step=[-1, 1, 0], driver=[0, -1, 0])
    about = {"team": {"scene": {"lidar_cells": 4}}, "hmi": "random:0.2"}
    object.__setattr__(made.observed, "about", about)
    write_demonstrations(folder, made)
    return folder


def use(folder: Path) -> object:
    """Read a dataset, and what is made of its description."""
    found = read_demonstrations(folder)
    env_spec(found.observed)
    team_of(found.observed)
    return found


def observed_file(folder: Path) -> Case:
    path = dataset(folder) / OBSERVED
    (folder / TRUTH).unlink()  # which holds the checksum of the whole observed file
    return bytes_of(path, lambda: use(folder), checked=True)


def truth_file(folder: Path) -> Case:
    return bytes_of(dataset(folder) / TRUTH, lambda: use(folder), checked=True)


def signed_stamp(folder: Path) -> Case:
    """Mutate the description in a parquet file, with its checksum."""
    path = dataset(folder) / OBSERVED
    (folder / TRUTH).unlink()
    table = pq.read_table(path)
    value = json.loads(table.schema.metadata[b"hmi-marl"])

    def mutate(seed: int) -> None:
        text = hostile_json(value, seed)
        write_signed(path, table.replace_schema_metadata({"hmi-marl": text}))

    return Case(path, lambda: use(folder), mutate)


def signed_rows(folder: Path) -> Case:
    """Mutate the numbers of a parquet file, which stays whole, with their checksum."""
    path = dataset(folder) / OBSERVED
    (folder / TRUTH).unlink()
    table = pq.read_table(path)

    def mutate(seed: int) -> None:
        rng = np.random.default_rng(seed)
        name = str(rng.choice(table.column_names))
        values: list[Any] = table[name].to_pylist()
        at, field = int(rng.integers(len(values))), table.schema.field(name)
        nasty = ["", "x" * 100_000, None] if name == "driver" else [0, 1, 7, 127, None]
        values[at] = nasty[int(rng.integers(len(nasty)))]
        if name == "crashed":
            values[at] = bool(values[at])
        kind = pa.string() if name == "driver" else field.type
        made = pa.array(values, kind)
        made = made.dictionary_encode() if name == "driver" else made
        changed = table.set_column(table.column_names.index(name), field.with_nullable(True), made)
        write_signed(path, changed)

    return Case(path, lambda: use(folder), mutate)


def driver_file(folder: Path) -> Case:
    path = folder / "mona.json"
    write_driver(path, Driver("mona", 0.1, 0.5, 0.2, 2.0), {"trips": 3})
    return json_of(path, lambda: get_driver(str(path)))


def signed_driver_file(folder: Path) -> Case:
    path = driver_file(folder).path
    return signed_json(path, lambda: get_driver(str(path)))


def trips_of_a_person(folder: Path) -> Case:
    path = folder / "trips.json"
    path.write_text(json.dumps([a_trip(steps=5, visitor="ada").record().to_json()]))
    return json_of(path, lambda: measurable(read_trips([path])))


def trip(folder: Path) -> Case:
    path = folder / "trip.json"
    path.write_text(json.dumps(a_trip("graded", steps=5).record().to_json()))
    return json_of(path, lambda: TripRecord.from_json(read_json(path)))


def people_database(folder: Path) -> Case:
    path = folder / "people.db"
    with Store(path) as store:
        session = store.new_session(store.new_visitor().number, "play", {"page": 1})
        store.begin_trip(session, a_trip(steps=5).record())
        store.answer(session, "safe", 5)
        store.forget()
    content = path.read_bytes()

    def mutate(seed: int) -> None:
        for log in folder.glob("people.db-*"):
            log.unlink()
        path.write_bytes(hostile(content, seed))

    def read() -> object:
        with Store(path, make=False) as store:
            return [*store.trips(), *store.sessions(), *store.answers()]

    return Case(path, read, mutate)


def study_manifest(folder: Path) -> Case:
    study = a_study(folder / "study")
    path = study.folder / "study.json"
    return json_of(path, lambda: read_study(study.folder), checked=True)


def signed_study_manifest(folder: Path) -> Case:
    study = a_study(folder / "study")
    return signed_json(study.folder / "study.json", lambda: read_study(study.folder))


def study_answers(folder: Path) -> Case:
    study, path = a_study(folder / "study"), folder / "answers.csv"
    write_answers(path, simulated_answers(study, 3, Plan()))
    content = path.read_bytes()

    def mutate(seed: int) -> None:
        path.write_bytes(hostile(content, seed))

    return Case(path, lambda: read_ratings(path, study), mutate)


def kept_result(folder: Path) -> Case:
    place, key = Kept(folder, Sums), {"driver": "a"}
    place.keep(key, Sums(3, 1, 20, 0.1, 4, math.nan, {"speed_reward": 0.5}))
    (path,) = folder.rglob("*.played")
    return bytes_of(path, lambda: place.read(key), checked=True)


def signed_kept_result(folder: Path) -> Case:
    """Mutate a kept result, with the right checksum of what it is now."""
    case = kept_result(folder)
    content = case.path.read_bytes()[64:]

    def mutate(seed: int) -> None:
        changed = hostile_tensors(content, seed, "result")
        case.path.write_bytes(hashlib.sha256(changed).hexdigest().encode() + changed)

    return Case(case.path, case.read, mutate)


CASES = {
    case.__name__: case
    for case in (
        policy,
        policy_bytes,
        signed_policy,
        signed_policy_weights,
        traits,
        signed_traits,
        evidence,
        signed_evidence,
        index,
        signed_index,
        checkpoint,
        signed_checkpoint,
        settings_file,
        curve,
        preferences,
        block,
        record,
        signed_record,
        map_case,
        signed_map_case,
        observed_file,
        truth_file,
        signed_stamp,
        signed_rows,
        trip,
        trips_of_a_person,
        driver_file,
        signed_driver_file,
        people_database,
        study_manifest,
        signed_study_manifest,
        study_answers,
        kept_result,
        signed_kept_result,
    )
}
