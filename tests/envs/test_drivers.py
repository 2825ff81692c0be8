import math

import numpy as np
import pytest

from hmi_marl.envs.drivers import (
    DRIVERS,
    Choice,
    Driver,
    DriverList,
    TraitDistributions,
    Traits,
    Uniform,
    as_population,
    check_traits,
    get_driver,
    known_name,
)


def test_the_known_drivers_have_the_papers_traits():
    assert {name: driver.traits for name, driver in DRIVERS.items()} == {
        "lisa": (0.2, 0.8, 0.01, 3.0),
        "marge": (0.2, 0.8, 1.0, 9.0),
        "bart": (0.8, 0.2, 0.01, 3.0),
        "homer": (0.8, 0.2, 1.0, 9.0),
        "average": (0.5, 0.5, 0.505, 6.0),
    }


@pytest.mark.parametrize("trait", ["beta", "alpha", "eta"])
@pytest.mark.parametrize("value", [-0.1, 1.2, math.nan, math.inf])
def test_a_probability_outside_0_to_1_is_refused_by_name(trait, value):
    traits = {"beta": 0.5, "alpha": 0.5, "eta": 0.5, "inflation": 3.0} | {trait: value}
    with pytest.raises(ValueError, match=rf"'mona': {trait} lies in \[0, 1\]"):
        Driver("mona", **traits)


@pytest.mark.parametrize("inflation", [0.9, 0.0, -3.0, math.nan, 1e9])
def test_an_inflation_out_of_range_is_refused(inflation):
    with pytest.raises(ValueError, match="inflation lies in"):
        Driver("mona", 0.5, 0.5, 0.5, inflation)


def test_a_trait_that_is_no_number_is_refused():
    with pytest.raises(TypeError, match="beta is a number"):
        Driver("mona", "0.5", 0.5, 0.5, 3.0)
    with pytest.raises(TypeError, match="name"):
        Driver("", 0.5, 0.5, 0.5, 3.0)


def test_the_error_for_an_unknown_driver_names_the_known_ones():
    with pytest.raises(ValueError, match=r"unknown driver 'ned'.*lisa, marge, bart, homer, avera"):
        get_driver("ned")
    with pytest.raises(TypeError, match="name or a Driver"):
        get_driver(3)


def test_drivers_are_found_by_name_whatever_the_case():
    assert get_driver("Homer") is DRIVERS["homer"]
    assert known_name(*DRIVERS["bart"].traits) == "bart"
    assert known_name(0.1, 0.1, 0.1, 1.0) is None


def test_traits_stack_and_unstack():
    traits = Traits.of([DRIVERS["lisa"], DRIVERS["homer"]])
    assert len(traits) == 2
    assert traits.beta.tolist() == [0.2, 0.8]
    assert Traits.from_array(traits.as_array()).as_array().tolist() == traits.as_array().tolist()
    with pytest.raises(ValueError, match=r"\(N, 4\)"):
        Traits.from_array(np.zeros(4))


def test_a_list_is_drawn_from_evenly_and_by_seed_alone():
    population = as_population(["lisa", "bart", Driver("mona", 0.4, 0.4, 0.4, 4.0)])
    seeds = np.arange(30_000, dtype=np.uint64)
    beta = population.draw(seeds).beta
    for value in (0.2, 0.8, 0.4):
        assert abs((beta == value).mean() - 1 / 3) < 4 * np.sqrt(2 / 9 / 30_000)
    assert population.draw(seeds[7:8]).beta[0] == beta[7]


def test_distributions_draw_each_trait_independently_within_its_range():
    population = TraitDistributions(
        beta=Uniform(0.1, 0.3), alpha=Uniform(0.7, 0.7), eta=Choice((0.01, 1.0))
    )
    traits = population.draw(np.arange(20_000, dtype=np.uint64))
    assert (traits.beta >= 0.1).all()
    assert (traits.beta < 0.3).all()
    assert abs(traits.beta.mean() - 0.2) < 4 * 0.2 / np.sqrt(12 * 20_000)
    assert set(traits.alpha) == {0.7}
    assert set(traits.eta) == {0.01, 1.0}
    assert 1.0 <= traits.inflation.min() < 1.1
    assert 8.9 < traits.inflation.max() < 9.0
    correlation = np.corrcoef(traits.beta, traits.inflation)[0, 1]
    assert abs(correlation) < 4 / np.sqrt(20_000)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TraitDistributions(beta=Uniform(0.5, 1.2)), "beta lies in"),
        (lambda: TraitDistributions(inflation=Choice((0.5, 2.0))), "inflation lies in"),
        (lambda: Uniform(0.5, 0.4), "low <= high"),
        (lambda: Uniform(math.nan, 0.4), "low lies in"),
        (lambda: Uniform(0.0, math.inf), "high lies in"),
        (lambda: Choice(()), "number of values lies in"),
        (lambda: Choice((0.2, math.nan)), "each of Choice: values lies in"),
        (lambda: Choice((math.nan, 0.2)), "each of Choice: values lies in"),
        (lambda: TraitDistributions(eta=Choice((0.2, 1.5, 0.4))), "eta lies in"),
        (lambda: DriverList(()), "at least one driver"),
        (lambda: as_population([]), "at least one driver"),
        (lambda: as_population(["lisa", "ned"]), "unknown driver 'ned'"),
    ],
)
def test_a_bad_population_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Uniform("0", 1.0), "Uniform: low is a number, not '0'"),
        (lambda: Uniform(0.0, True), "Uniform: high is a number, not True"),
        (lambda: Choice((0.2, "0.4")), "each of Choice: values is a number, not '0.4'"),
        (lambda: Choice("0.2"), "Choice: values is a tuple of numbers"),
        (lambda: Choice(0.2), "Choice: values is a tuple of numbers"),
        (lambda: TraitDistributions(beta=0.5), "beta is a Uniform or a Choice, not 0.5"),
        (lambda: DriverList("homer"), "DriverList takes a list or tuple of drivers, not 'homer'"),
        (lambda: DriverList(DRIVERS["homer"]), "DriverList takes a list or tuple"),
    ],
)
def test_a_population_of_the_wrong_type_is_refused(make, message):
    with pytest.raises(TypeError, match=message):
        make()


@pytest.mark.parametrize(
    "drivers", [3, None, {"lisa", "bart"}, (name for name in ["lisa"]), {"lisa": 1}, DriverList]
)
def test_what_is_no_population_at_all_is_refused(drivers):
    with pytest.raises(TypeError, match="driver= takes a name"):
        as_population(drivers)


def drawn(**changes):
    traits = {"beta": 0.5, "alpha": 0.5, "eta": 0.5, "inflation": 3.0}
    return Traits(**{name: np.full(2, value) for name, value in traits.items()} | changes)


def test_possible_drivers_pass_the_check_of_what_was_drawn():
    good = drawn()
    assert check_traits(good, 2) is good


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"beta": np.array([0.5, math.nan])}, r"beta lies in \[0, 1\], but got nan"),
        ({"alpha": np.array([-0.1, 0.5])}, r"alpha lies in \[0, 1\], but got -0.1"),
        ({"eta": np.array([0.5, math.inf])}, "eta lies in"),
        ({"inflation": np.array([0.5, 2.0])}, "inflation lies in"),
        ({"inflation": np.array([3.0])}, r"inflation is .* of shape \(2,\), but got .*\(1,\)"),
        ({"beta": 0.5}, "beta is an array"),
        ({"beta": np.array(["0.5", "0.5"])}, "beta is an array of numbers"),
    ],
)
def test_impossible_drivers_are_refused_by_the_name_of_the_trait(changes, message):
    with pytest.raises(ValueError, match=message):
        check_traits(drawn(**changes), 2)


def test_what_was_drawn_must_be_traits():
    with pytest.raises(TypeError, match="a Population draws Traits"):
        check_traits(np.zeros((2, 4)), 2)


def test_a_custom_driver_can_be_written_as_text():
    assert get_driver("mona:0.4,0.3,0.5,2") == Driver("mona", 0.4, 0.3, 0.5, 2.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mona:0.4,0.3,0.5", "name:beta,alpha,eta,inflation"),
        ("mona:a,b,c,d", "name:beta,alpha,eta,inflation"),
        ("mona:0.4,0.3,1.5,2", "eta lies in"),
        ("mona:nan,0.3,0.5,2", "beta lies in"),
        ("../mona:0.4,0.3,0.5,2", "letters, digits"),
        (":0.4,0.3,0.5,2", "letters, digits"),
    ],
)
def test_a_driver_written_down_wrongly_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        get_driver(text)
