from io import BytesIO

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.patches import Ellipse

from hmi_marl.experiments.latent_traits.figures import (
    DRIVER_COLOURS,
    EmbeddingPanel,
    draw_accuracy,
    draw_embeddings,
)
from hmi_marl.reporting.statistics import Estimate, share

NAMES = ("homer", "lisa", "marge", "bart")
TYPES = np.repeat(np.arange(4), 20)


def panel(title="unsupervised", size=2, kl=435.2, names=NAMES):
    means = 3.0 * TYPES[:, None] + np.random.default_rng(0).normal(size=(80, size))
    return EmbeddingPanel(title, means, TYPES, names, kl)


def texts(axes):
    return [text.get_text() for text in axes.texts]


def saved(figure):
    content = BytesIO()
    figure.savefig(content, format="png", dpi=40)
    return content.getvalue()


def test_a_panel_for_each_setting_with_its_average_kl():
    figure = draw_embeddings(
        [panel(), panel("by identity", kl=4940.0), panel("by preference", kl=0.123)]
    )
    assert [axes.get_title() for axes in figure.axes] == [
        "unsupervised", "by identity", "by preference"
    ]  # fmt: skip
    shown = [texts(axes) for axes in figure.axes]
    assert shown == [["average KL 435"], ["average KL 4,940"], ["average KL 0.12"]]
    assert saved(figure).startswith(b"\x89PNG")


def test_drivers_are_told_in_the_fields_order_each_in_its_colour():
    figure = draw_embeddings([panel(), panel(names=("mona", "bart", "lisa", "marge"))])
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["lisa", "marge", "bart", "homer", "mona"]
    colours = [to_hex(handle.get_color()) for handle in legend.legend_handles]
    assert colours == list(DRIVER_COLOURS[:5])
    # the second panel has no homer, and mona in the fifth colour
    drawn = [to_hex(points.get_facecolor()[0]) for points in figure.axes[1].collections]
    used = [
        c
        for c, points in zip(drawn, figure.axes[1].collections, strict=True)
        if len(points.get_offsets())
    ]
    assert used == [DRIVER_COLOURS[place] for place in (0, 1, 2, 4)]


def test_points_are_the_vectors():
    own = panel()
    lisa = draw_embeddings([own]).axes[0].collections[0].get_offsets()
    assert np.array_equal(lisa, own.means[TYPES == 1])


def test_ellipses_are_two_standard_deviations_worked_by_hand():
    # along the diagonal: variances 4 and 1 of four points about (1, 2)
    turn = np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2.0)
    a, b = 2.0 * np.sqrt(1.5), np.sqrt(1.5)
    points = np.array([[a, 0.0], [-a, 0.0], [0.0, b], [0.0, -b]]) @ turn + [1.0, 2.0]
    means, types = np.concatenate([points, points + 9.0]), np.repeat([0, 1], 4)
    axes = draw_embeddings([EmbeddingPanel("it", means, types, ("lisa", "marge"), 1.0)]).axes[0]
    ellipse, other = (patch for patch in axes.patches if isinstance(patch, Ellipse))
    assert ellipse.center == pytest.approx((1.0, 2.0))
    assert other.center == pytest.approx((10.0, 11.0))
    assert (ellipse.width, ellipse.height) == pytest.approx((8.0, 4.0))
    assert ellipse.angle % 180.0 == pytest.approx(45.0)


def test_few_vectors_have_no_ellipse():
    own = EmbeddingPanel("it", np.eye(4)[:, :2], np.array([0, 0, 1, 1]), ("lisa", "marge"), 1.0)
    assert not draw_embeddings([own]).axes[0].patches


def test_two_dimensions_are_drawn_as_they_are_and_more_by_principal_axes():
    plain, more = draw_embeddings([panel(), panel(size=5)]).axes
    assert (plain.get_xlabel(), plain.get_ylabel()) == ("$z_1$", "$z_2$")
    assert more.get_xlabel().startswith("first of 5 principal axes of z (9")
    assert more.get_ylabel().startswith("second of 5 principal axes of z (")


def test_principal_axes_worked_by_hand():
    # variances 9 : 1 : 0 along z3, z1 and z2
    means = np.zeros((4, 3))
    means[:, 2], means[:, 0] = [3.0, -3.0, 3.0, -3.0], [1.0, 1.0, -1.0, -1.0]
    own = EmbeddingPanel("it", means, np.array([0, 0, 1, 1]), ("lisa", "marge"), 1.0)
    axes = draw_embeddings([own]).axes[0]
    points = np.asarray(axes.collections[0].get_offsets())
    assert points == pytest.approx(np.array([[3.0, 1.0], [-3.0, 1.0]]))
    assert axes.get_xlabel() == "first of 3 principal axes of z (90%)"


def test_single_numbers_are_drawn_along_a_line():
    axes = draw_embeddings([panel(size=1)]).axes[0]
    points = np.asarray(axes.collections[0].get_offsets())
    assert points[:, 0] == pytest.approx(panel(size=1).means[TYPES == 1, 0])
    assert not points[:, 1].any()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("$z_1$", "")


def test_collapsed_vectors_can_be_drawn():
    for size in (1, 2, 3):
        own = EmbeddingPanel("it", np.zeros((80, size)), TYPES, NAMES, 0.0)
        assert saved(draw_embeddings([own]))


def test_panels_that_cannot_be_drawn_are_refused():
    with pytest.raises(ValueError, match="no embeddings"):
        draw_embeddings([])
    with pytest.raises(ValueError, match="types of 'it' are 0 to 1 for lisa, marge, not 0 to 3"):
        EmbeddingPanel("it", np.zeros((80, 2)), TYPES, ("lisa", "marge"), 0.0)
    with pytest.raises(ValueError, match="vectors of 'it' are finite"):
        EmbeddingPanel("it", np.full((80, 2), np.nan), TYPES, NAMES, 0.0)


WINDOWS = (1, 2, 4, 8, 16)
CURVES = {
    "unsupervised": [share(hits, 100) for hits in (25, 30, 33, 40, 44)],
    "by identity": [share(hits, 100) for hits in (60, 70, 80, 90, 100)],
}


def test_accuracy_has_a_line_for_each_setting_a_ceiling_and_chance():
    figure = draw_accuracy(WINDOWS, CURVES, [0.7, 0.8, 0.9, 0.95, 1.0], 0.25)
    (axes,) = figure.axes
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["unsupervised", "by identity", "exact Bayes", "chance"]
    lines = {line.get_label(): line for line in axes.lines}
    assert lines["exact Bayes"].get_linestyle() == "--"
    assert list(lines["exact Bayes"].get_ydata()) == [0.7, 0.8, 0.9, 0.95, 1.0]
    assert lines["chance"].get_linestyle() == ":"
    assert set(lines["chance"].get_ydata()) == {0.25}
    assert [label.get_text() for label in axes.get_xticklabels()] == ["1", "2", "4", "8", "16"]
    assert saved(figure).startswith(b"\x89PNG")


def test_accuracies_and_their_intervals_are_those_given():
    axes = draw_accuracy(WINDOWS, CURVES, 1.0, 0.25).axes[0]
    for container, curve in zip(axes.containers, CURVES.values(), strict=True):
        line, _, (bars,) = container
        assert list(line.get_ydata()) == [estimate.mean for estimate in curve]
        ends = np.array([segment[:, 1] for segment in bars.get_segments()])
        wanted = np.array([[estimate.low, estimate.high] for estimate in curve])
        assert ends == pytest.approx(wanted)


def test_one_ceiling_for_all_and_points_without_an_interval():
    curve = [Estimate(0.5, np.nan, np.nan)] * 2
    figure = draw_accuracy([1, 2], {"it": curve}, 0.9, 0.25)
    lines = {line.get_label(): line for line in figure.axes[0].lines}
    assert list(lines["exact Bayes"].get_ydata()) == [0.9, 0.9]
    assert saved(figure)


def test_without_a_ceiling_there_is_no_line_of_it():
    figure = draw_accuracy(WINDOWS, CURVES, None, 0.25)
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["unsupervised", "by identity", "chance"]
    assert "exact Bayes" not in [line.get_label() for line in figure.axes[0].lines]


def test_curves_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="5 numbers of windows, but it has 4 points"):
        draw_accuracy(WINDOWS, {"it": CURVES["unsupervised"][:4]}, 1.0, 0.25)
    with pytest.raises(ValueError, match=r"5 numbers of windows, but the ceiling has shape \(2,\)"):
        draw_accuracy(WINDOWS, CURVES, [0.9, 1.0], 0.25)
    for odd in ((), (0, 1), (2, 1), (1, 1)):
        with pytest.raises(ValueError, match="rise from 1 or more"):
            draw_accuracy(odd, {}, 1.0, 0.25)
