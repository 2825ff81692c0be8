"""The paper's experiments on latent traits, made again: collect, learn three settings, judge."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.agents.learned.trait_model import TraitModel, load_traits
from hmi_marl.demonstrations.parquet import (
    OBSERVED,
    TRUTH,
    read_about,
    read_demonstrations,
    write_demonstrations,
)
from hmi_marl.demonstrations.recording import collect
from hmi_marl.envs.config import DRIVER
from hmi_marl.experiments.latent_traits.assessment import (
    PARTS,
    Assessment,
    assess,
    exact_evidence,
    supervision_of,
)
from hmi_marl.experiments.latent_traits.ceiling import NoCeilingError
from hmi_marl.experiments.latent_traits.driving import check_fits
from hmi_marl.experiments.latent_traits.identification import (
    Split,
    pool_sizes,
    population_pools,
    strangers,
)
from hmi_marl.experiments.latent_traits.report import as_json, as_text, exhibits
from hmi_marl.experiments.latent_traits.settings import (
    DEMONSTRATIONS,
    POPULATION,
    SUPERVISIONS,
    AssessSettings,
    TraitReproduction,
)
from hmi_marl.experiments.stages import Outcome
from hmi_marl.files import json_value, make_folder, sha256_of, write_bytes, write_json, write_text
from hmi_marl.reporting.blocks import page_of, pictures
from hmi_marl.training.runs.folder import FREE as MACHINE
from hmi_marl.training.runs.folder import check_same
from hmi_marl.training.runs.jobs import own_line, side_by_side
from hmi_marl.training.traits.settings import TraitSettings

FREE = ("driver_policy", "teams")
"""What a dataset may differ in: where the policy lies (which it is, is looked at), and memory."""


def collect_datasets(settings: TraitReproduction, driver_run: Path, folder: Path) -> None:
    """Record what is not recorded yet, and see that it is enough to judge by.

    Raises:
        FileNotFoundError: there is no such driver policy.
        ValueError: a dataset that is there was recorded otherwise, or there is too little.
    """
    for name, dataset in settings.datasets(driver_run).items():
        truth = folder / name / TRUTH
        if truth.is_file():  # which is written last
            about = read_about(truth)
            before = _binding(about.get("settings", {}))
            check_same(before, _binding(json_value(dataset)), truth.parent)
            _check_driver(about, driver_run, truth.parent)
            continue
        make_folder(folder / name)
        with tqdm(total=dataset.total_steps, unit=" steps", unit_scale=True, desc=name) as bar:
            write_demonstrations(folder / name, collect(dataset, bar.update))
    learn, demonstrations = settings.learn, read_demonstrations(folder / DEMONSTRATIONS)
    split = Split.of(demonstrations, learn.held_out, settings.judge.windows)
    pool_sizes(split, learn.pool, learn.latent)
    population_pools(read_demonstrations(folder / POPULATION), learn.pool)


def _check_driver(about: Mapping[str, Any], driver_run: Path, folder: Path) -> None:
    weights = find_policy(driver_run, DRIVER).with_suffix(".safetensors")
    if about["driver_policy"].get("sha256") != sha256_of(weights):
        raise ValueError(
            f"{folder} was recorded with another driver policy than that of {driver_run}; choose "
            "another --out, or remove the folder"
        )


def _binding(settings: dict[str, Any]) -> dict[str, Any]:
    return {"settings": {name: value for name, value in settings.items() if name not in FREE}}


def learn_all(settings: TraitReproduction, folder: Path, workers: int, command_line: str) -> None:
    """Learn every setting, ``workers`` at a time; finished ones are left alone.

    Raises:
        ValueError: what :func:`hmi_marl.training.traits.run.learn_traits` refuses.
    """
    jobs, data = settings.trainings(folder), folder / DEMONSTRATIONS
    side_by_side(_learn, [(job, data, out, command_line) for out, job in jobs.items()], workers)


def _learn(settings: TraitSettings, demonstrations: Path, folder: Path, command_line: str) -> None:
    from hmi_marl.training.traits.run import learn_traits  # torch, with the threads just set

    settings = replace(settings, threads=1)
    learn_traits(settings, demonstrations, folder, command_line=command_line, line=own_line())


def assess_runs(
    runs: Sequence[Path],
    demonstrations: Path,
    population: Path | None,
    driver_policy: str | None,
    size: AssessSettings,
) -> tuple[dict[str, list[Assessment]], int]:
    """Judge trained runs on what they held out.

    Args:
        runs: their folders.
        demonstrations: that they learned from.
        population: of drivers they did not; None to leave that out.
        driver_policy: whose the demonstrations are; None: as they tell it.
        size: how much.

    Returns:
        Assessments by supervision, and the size of the pools. The first model of a setting is
        judged in every respect, others by how well they tell drivers apart.

    Raises:
        FileNotFoundError, ValueError: no such runs or demonstrations, or runs that learned from
            other demonstrations or that pool or hold out differently.
    """
    models = [load_traits(run) for run in runs]
    data = read_demonstrations(demonstrations)
    pools, digest = models[0].card.pool, sha256_of(demonstrations / OBSERVED)
    share, _ = _learned_from(runs[0], models[0])
    for run, model in zip(runs, models, strict=True):
        held_out, learned = _learned_from(run, model)
        if (model.card.pool, held_out) != (pools, share):
            raise ValueError(f"{run} pools or holds out other windows than {runs[0]}")
        if learned != digest:
            raise ValueError(f"{run} learned from other demonstrations than {demonstrations}")
    _check_seeds(runs, models)
    split = Split.of(data, share, size.windows)
    windows = pool_sizes(split, pools, max(model.card.latent for model in models))
    unknown = None
    if population is not None:
        unknown = strangers(read_demonstrations(population), data)
        population_pools(unknown, pools)
        check_fits(models[0], unknown.observed)
    found: dict[str, list[Assessment]] = {}
    with tqdm(total=1 + PARTS * len(models), unit=" parts", desc="judging") as bar:
        exact = None
        try:
            exact = exact_evidence(split.unseen, driver_policy)
        except NoCeilingError as error:
            bar.write(str(error), file=sys.stderr)
        bar.update()
        for model in models:
            first = supervision_of(model) not in found
            one = assess(model, split, exact, unknown, size, windows, bar.update, whole=first)
            found.setdefault(one.supervision, []).append(one)
    ordered: dict[str, list[Assessment]] = {
        name: found[name] for name in SUPERVISIONS if name in found
    }
    return ordered, pools


def _check_seeds(runs: Sequence[Path], models: Sequence[TraitModel]) -> None:
    """Raise unless runs of one supervision differ in their seed and in nothing else."""
    first: dict[str, tuple[Path, dict[str, Any]]] = {}
    seen: dict[tuple[str, int], Path] = {}
    for run, model in zip(runs, models, strict=True):
        told = dict(model.card.training["settings"])
        seed, supervision = told.pop("seed", None), supervision_of(model)
        if (supervision, seed) in seen:
            raise ValueError(f"{run} and {seen[supervision, seed]} are of one seed")
        seen[supervision, seed] = run
        other, settings = first.setdefault(supervision, (run, told))
        odd = [n for n in told if n not in MACHINE and told[n] != settings.get(n)]
        if odd:
            raise ValueError(
                f"{run} was learned with another {odd[0]} than {other}: runs of one supervision "
                "are taken for seeds of one setting; judge them one at a time"
            )


def _learned_from(run: Path, model: TraitModel) -> tuple[float, str]:
    """The share that a run held out, and the checksum of its demonstrations."""
    told = model.card.training
    try:
        return float(told["settings"]["held_out"]), str(told["demonstrations"])
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"{run} does not tell what it learned from") from None


def write_report(
    folder: Path,
    assessments: Mapping[str, Sequence[Assessment]],
    pools: int,
    seconds: Mapping[str, float],
    command_line: str,
    settings: Mapping[str, Any],
) -> Outcome:
    """Write the page, the figures and the numbers into ``folder``."""
    text, numbers = as_text(assessments, pools, seconds), as_json(assessments, pools)
    shown = exhibits(assessments, pools)
    write_text(folder / "traits.txt", text + "\n")
    about = {"seconds": dict(seconds), "command": command_line, "judged_with": settings}
    write_json(folder / "traits-report.json", numbers | about)
    for name, drawing in zip(("embeddings.png", "accuracy.png"), pictures(shown), strict=True):
        write_bytes(folder / name, drawing)
    html = page_of("Latent traits", shown, seconds, command_line, settings)
    write_text(folder / "index.html", html)
    return Outcome(numbers, shown, seconds, text)
