import re

import pytest

from hmi_marl.people.web.pages import STATIC

SHEET = (STATIC / "site.css").read_text("utf-8")
ROOTS = re.findall(r":root {(.*?)}", SHEET, re.DOTALL)


def luminance(colour):
    channels = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return sum(c * weight for c, weight in zip(linear, (0.2126, 0.7152, 0.0722), strict=True))


def contrast(one, other):
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", range(2), ids=["light", "dark"])
def test_what_is_drawn_stands_out_from_the_road_and_texts_from_pages(scheme):
    colours = dict(re.findall(r"--([\w-]+): (#\w{6});", ROOTS[scheme]))
    for name in ("car", "car-other", "car-crashed", "ring", "road-line"):
        assert contrast(colours[name], colours["road"]) >= 3.0, name
    for back in ("back", "card"):
        for name in ("ink", "soft", "accent", "alarm", "good"):
            assert contrast(colours[name], colours[back]) >= 4.5, (name, back)
        assert contrast(colours["focus"], colours[back]) >= 3.0, back


def test_the_contrast_of_black_and_white_is_known():
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)
