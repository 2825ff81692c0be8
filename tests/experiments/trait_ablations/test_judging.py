"""Traits read by probes, and rows compared with the default, against values by hand."""

import numpy as np
import pytest

from hmi_marl.agents.learned.trait_encoder import Latent
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.trait_ablations import judging
from hmi_marl.experiments.trait_ablations.judging import SCORES, Errors, Judged, read_errors
from hmi_marl.experiments.trait_ablations.rows import rows_of
from hmi_marl.experiments.trait_ablations.variants import AXES, BY_NAME, POOL, POOLS, VARIANTS
from hmi_marl.files import json_value
from hmi_marl.reporting.statistics import share
from hmi_marl.training.ablations.design import EncoderDesign


def judged(error: float, pools: tuple[int, ...] = (8,), strangers: int = 200) -> Judged:
    """Results with squared errors of about this size, for a variance of one."""
    rng = np.random.default_rng(0)
    shape = strangers, len(TRAIT_NAMES)
    sizes = (1.0, error, error)
    errors = {n: Errors(*(each * rng.chisquare(1, shape) for each in sizes)) for n in pools}
    return Judged(errors, {size: share(90, 100) for size in pools})


def test_errors_are_summed_up_by_stranger(monkeypatch):
    """Four strangers judge, with two pools each that lie apart in the table."""
    rng = np.random.default_rng(0)
    who = np.array([7, 3, 3, 9, 5, 5, 9, 7, 1, 1])
    fits = who == 1
    z, traits = rng.standard_normal((10, 2)), rng.uniform(size=(10, 4))
    monkeypatch.setattr(judging, "read_linearly", lambda *sides: sides[2][:, :1] * np.ones(4))
    monkeypatch.setattr(judging, "predict_traits", lambda *sides: sides[2][:, 1:] * np.ones(4))
    found = read_errors(z, traits, who, fits, seed=0)
    true = traits[~fits]
    for row, stranger in enumerate((3, 5, 7, 9)):
        own = who == stranger
        wanted = (
            ((traits[own] - true.mean(axis=0)) ** 2).sum(axis=0),
            ((z[own, :1] - traits[own]) ** 2).sum(axis=0),
            ((z[own, 1:] - traits[own]) ** 2).sum(axis=0),
        )
        for errors, values in zip(vars(found).values(), wanted, strict=True):
            np.testing.assert_allclose(errors[row], values)


def test_traits_that_lie_in_z_are_read():
    rng = np.random.default_rng(0)
    who = np.repeat(np.arange(200), 2)
    traits = np.repeat(rng.uniform(size=(200, 4)), 2, axis=0)
    z = traits @ rng.standard_normal((4, 4)) + 0.02 * rng.standard_normal((400, 4))
    found = read_errors(z, traits, who, who % 2 == 0, seed=0)
    assert found.linear.shape == (100, 4)
    for read, most in ((found.linear, 0.1), (found.network, 0.4)):
        assert (read.sum(axis=0) < most * found.spread.sum(axis=0)).all()


def test_types_are_named_by_what_an_encoder_learned_by():
    of = Latent(np.array([[1.0, 0.0], [4.0, 4.1]]), np.ones((2, 2)))
    prototypes = Latent(np.array([[8.0, 0.1], [0.5, 0.5]]), np.ones((2, 2)))
    assert SCORES["cosine"](of, prototypes).argmax(axis=1).tolist() == [0, 1]
    assert SCORES["margin"](of, prototypes).argmax(axis=1).tolist() == [1, 1]
    assert SCORES["distance"](of, prototypes)[0, 1] == -0.5


def test_rows_follow_the_axes_and_compare_with_the_default():
    chosen = [
        BY_NAME[n] for n in ("baseline", "loss-cosine", "latent-16", "latent-2", "strangers-100")
    ]
    found = {each.name: judged(0.3) for each in chosen} | {"baseline": judged(0.2, POOLS)}
    rows = rows_of(found, chosen, {"strangers": 2000, "windows": 16, "latent": 8}, pool=8)
    places = [(row.axis, row.what, row.default) for row in rows]
    assert places[:7] == [
        ("loss", "posteriors", True),
        ("loss", "cosine", False),
        ("strangers", "100", False),
        ("strangers", "2000", True),
        ("latent", "2", False),
        ("latent", "8", True),
        ("latent", "16", False),
    ]
    assert places[7:] == [(POOL, str(size), size == 8) for size in POOLS]
    errors, base = found["loss-cosine"].errors[8], found["baseline"].errors[8]
    for k, trait in enumerate(TRAIT_NAMES):
        r2 = [1 - e.network[:, k].sum() / e.spread[:, k].sum() for e in (errors, base)]
        assert rows[1].network[trait].mean == pytest.approx(r2[0])
        assert rows[1].more[trait].mean == pytest.approx(r2[0] - r2[1])
        assert rows[0].more[trait].mean == pytest.approx(0.0, abs=1e-12)
        assert rows[0].more[trait].error == pytest.approx(0.0, abs=1e-12)
        linear = 1 - errors.linear[:, k].sum() / errors.spread[:, k].sum()
        assert rows[1].linear[trait].mean == pytest.approx(linear)
        assert rows[1].more[trait].count == 200  # paired by stranger


def test_variants_change_one_thing_each():
    default, names = EncoderDesign(), [each.name for each in VARIANTS]
    assert len(set(names)) == len(names)
    for each in VARIANTS[1:]:
        assert each.axis in AXES
        designed = [n for n, v in vars(each.design).items() if v != getattr(default, n)]
        sized = [n for n in ("strangers", "windows", "latent") if getattr(each, n) is not None]
        assert designed + sized == [each.axis]
        if sized:
            assert float(each.what) == getattr(each, each.axis)


def test_results_are_read_again_and_damaged_ones_are_refused():
    content = json_value(judged(0.3, POOLS, strangers=5))
    again = Judged.from_json(content)
    assert json_value(again) == content
    for broken in ({}, {**content, "named": {"x": {}}}, {**content, "errors": {"8": {}}}):
        with pytest.raises(ValueError, match=r"no results|invalid literal"):
            Judged.from_json(broken)
    content["errors"]["8"]["linear"] = [[1.0]]
    with pytest.raises(ValueError, match=r"shape \(P, 4\), not \(1, 1\)"):
        Judged.from_json(content)
