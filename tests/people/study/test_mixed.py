"""The linear mixed model, against statsmodels' and by hand."""

import numpy as np
import pytest

from hmi_marl.people.study.mixed import RatingModel
from hmi_marl.people.study.order import CHECK, order


def ratings(raters, conditions, clips, shown, seed, deviations=(0.7, 0.5, 0.4, 1.0), kept=1.0):
    """Rater, clip and rating, and the clips' conditions."""
    rng = np.random.default_rng(seed)
    places = [
        (number, place.condition * clips + place.clip)
        for number in range(raters)
        for place in order(number, conditions, clips, shown)
        if place != CHECK
    ]
    rater, clip = np.array(places)[rng.random(len(places)) < kept].T
    condition = np.repeat(np.arange(conditions), clips)
    of_rater, of_both, of_clip, rest = deviations
    value = (
        4.0
        + of_rater * rng.standard_normal(raters)[rater]
        + of_both * rng.standard_normal((raters, conditions))[rater, condition[clip]]
        + of_clip * rng.standard_normal(len(condition))[clip]
        + rest * rng.standard_normal(len(rater))
        + 0.5 * condition[clip]
    )
    return rater, clip, value, condition


@pytest.mark.parametrize("kept", [1.0, 0.85])
def test_it_is_the_model_of_statsmodels(kept):
    pd = pytest.importorskip("pandas")
    smf = pytest.importorskip("statsmodels.formula.api")
    rater, clip, value, condition = ratings(20, 3, 4, 2, seed=5, kept=kept)
    ours = RatingModel(rater, clip, value, condition).fit
    data = pd.DataFrame({"y": value, "r": rater, "k": clip, "c": condition[clip], "all": 1})
    data["rc"] = 10 * data.r + data.c
    parts = {"r": "0 + C(r)", "rc": "0 + C(rc)", "k": "0 + C(k)"}
    theirs = smf.mixedlm("y ~ C(c) - 1", data, groups="all", re_formula="0", vc_formula=parts).fit()
    names = theirs.model.exog_vc.names
    spread = dict(zip(names, np.sqrt(theirs.vcomp), strict=True))
    assert ours.means == pytest.approx(theirs.fe_params.to_numpy(), abs=2e-4)
    assert ours.residual == pytest.approx(np.sqrt(theirs.scale), abs=1e-3)
    assert ours.rater == pytest.approx(spread["r"], abs=3e-3)
    assert ours.rater_condition == pytest.approx(spread["rc"], abs=3e-3)
    assert ours.clip == pytest.approx(spread["k"], abs=3e-3)
    whole = theirs.cov_params().iloc[:3, :3].to_numpy()
    for more, less in ((1, 0), (2, 0), (2, 1)):
        error = np.sqrt(whole[more, more] + whole[less, less] - 2 * whole[more, less])
        assert ours.contrast(more, less)[1] == pytest.approx(error, rel=3e-3)


def test_a_balanced_study_by_hand():
    # Each rater sees every clip, so that effects of raters cancel in contrasts: the difference is
    # that of the clips' means, and where clips differ, its error is that of these means.
    rng = np.random.default_rng(0)
    clips, raters = 6, 30
    effect = np.concatenate([rng.normal(0.0, 1.0, clips), rng.normal(1.0, 1.0, clips)])
    value = effect + 0.3 * rng.standard_normal((raters, 2 * clips))
    rater, clip = np.divmod(np.arange(value.size), 2 * clips)
    fit = RatingModel(rater, clip, value.ravel(), np.repeat([0, 1], clips)).fit
    means = value.mean(axis=0).reshape(2, clips)
    found, error = fit.contrast(1, 0)
    assert found == pytest.approx(means[1].mean() - means[0].mean(), abs=1e-9)
    pooled = means.var(axis=1, ddof=1).mean()
    assert error == pytest.approx(np.sqrt(2 * pooled / clips), rel=0.01)
    assert fit.freedom == 2 * clips - 2
    assert fit.clip == pytest.approx(np.sqrt(pooled), rel=0.02)


def test_without_any_spread_of_clips_there_is_none():
    rater, clip, value, condition = ratings(60, 3, 5, 2, 1, deviations=(0.0, 0.0, 0.0, 1.0))
    fit = RatingModel(rater, clip, value, condition).fit
    assert max(fit.rater, fit.clip) < 0.3
    assert fit.residual == pytest.approx(1.0, abs=0.1)
    same = RatingModel(rater, clip, np.full(len(rater), 4.0), condition).fit
    assert same.means == pytest.approx([4.0] * 3)


def test_fewer_raters_than_clips_limit_the_freedom():
    rater, clip, value, condition = ratings(5, 3, 10, 2, 1)
    assert RatingModel(rater, clip, value, condition).fit.freedom == 4


def test_too_little_is_refused():
    rater, clip, value, condition = ratings(4, 2, 3, 2, 1)
    with pytest.raises(ValueError, match="two raters or more"):
        RatingModel(rater * 0, clip, value, condition)
    with pytest.raises(ValueError, match="ratings of two clips or more"):
        RatingModel(rater, np.where(clip < 3, 0, clip), value, condition)
    with pytest.raises(ValueError, match="rates a clip once"):
        RatingModel(
            np.append(rater, rater[0]), np.append(clip, clip[0]), np.append(value, 1.0), condition
        )
