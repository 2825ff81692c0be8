import pytest
from cited import missing

from hmi_marl.experiments.alert_problem import alert_problem, audit_table
from hmi_marl.paper.audit import audit
from hmi_marl.reporting.blocks import as_text


def test_the_text_says_twice_that_a_cell_is_out_of_reach() -> None:
    title, head, *rows = audit_table(audit(window=7), window=7).as_text().splitlines()
    assert "N = 7" in title
    assert "94 to 100 steps" in title
    assert head.split()[:3] == ["HMI,", "driver", "paper"]
    assert len(rows) == 12
    out = [row for row in rows if "OUT OF REACH" in row]
    assert [row.split()[:3] for row in out] == [["own,", "lisa", "-85"], ["own,", "bart", "-123"]]
    assert all(row.endswith("  reachable") for row in rows if row not in out)
    assert "-200 to -179" in out[0]
    assert "-126 to -119" in out[1]


def test_the_optimum_is_listed_first_and_is_the_best() -> None:
    found = alert_problem("homer", 7, 50)
    best = next(iter(found.returns.values()))
    assert list(found.returns) == ["optimal", "when-distracted", "never", "always"]
    assert all(row.total_return <= best.total_return + 1e-9 for row in found.returns.values())
    assert not missing(found.blocks(), found.as_json())
    text = as_text(found.blocks())
    assert "homer: β = 0.8, α = 0.2, η = 1; N = 7, 50 steps" in text
    assert f"{best.total_return:.2f}" in text
    with pytest.raises(ValueError, match="siren"):
        alert_problem("siren", 7, 50)
