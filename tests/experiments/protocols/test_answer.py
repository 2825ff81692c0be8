"""The paragraph with which a comparison begins, from made-up results."""

from comparisons import SEEN, SMALL, arm_of, comparison, hidden

from hmi_marl.experiments.protocols.answer import answer


def test_the_answer_says_when_by_how_much_through_what_and_what_is_left():
    def share(pair):
        return 0.97 if arm_of(pair.driver) in ("joint", "simultaneous") else 0.35

    text = answer(hidden(share=share)).text
    for words in (
        "it helps: simultaneous learning earns 180.0",
        "0.90 [0.90, 0.91] of the way",
        "in 97 % of the steps (35 % with the two-stage driver)",
        "With a driver that learned alone its HMI earns 431",
        "that is surely less than the HMI for the average driver",
        "two-stage's own 601",
    ):
        assert words in text
    seen = answer(comparison(SEEN, lambda pair: 780.0)).text
    assert "no protocol is found to differ" in seen


def test_the_answer_says_less_where_every_protocol_earns_less():
    text = answer(comparison(SEEN, lambda p: 790.0 if "two-stage" in p.driver else 780.0)).text
    assert "at best 10.0 [10.0, 10.0] less than two-stage" in text


def test_the_answer_says_that_learning_together_harms_where_it_does():
    def worse(pair):
        return 500.0 if arm_of(pair.hmi) == "simultaneous" else 600.0

    text = answer(comparison(SMALL, worse)).text
    assert (
        "it harms: simultaneous learning earns 100.0 [100.0, 100.0] less attention return" in text
    )


def test_the_answer_gives_the_reason_of_a_difference_with_attention_seen():
    text = answer(comparison(SEEN, lambda p: 790.0 if "simul" in p.driver else 780.0)).text
    assert "simultaneous differs from two-stage" in text
    assert "By cause: simultaneous: of +10.0, +0.0 is the exact optimum over the lengths" in text
    assert "Two-stage earns 20.0 [20.0, 20.0] less than the exact optimum" in text
