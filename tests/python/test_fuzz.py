"""Some hundred cases of fuzz.py, the same every time; `make fuzz` runs it for longer."""

import pytest

from fuzz import CASES, outcome

# About five seconds each.
COUNTS = {"file": 700, "array": 700, "argument": 300}


@pytest.mark.parametrize("name", CASES)
def test_what_comes_in_is_used_or_refused_with_a_reason(name):
    wrong = {seed: what for seed in range(COUNTS[name]) if (what := outcome(name, seed))}
    assert wrong == {}
