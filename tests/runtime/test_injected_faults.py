"""What no fault in the lines, and no kill, may do to a set point."""

import secrets

import pytest
from faults.streams import inject


@pytest.mark.slow
@pytest.mark.parametrize("count", [100, pytest.param(1000, marks=pytest.mark.slow)])
def test_no_fault_makes_a_step_or_an_end_that_is_not_safe(count):
    seed = secrets.randbelow(2**31)
    ran, drawn, failures = inject(count, seed)
    assert ran == count
    kinds = [drawn[name] for name in ("stamp_ahead", "kill", "spike", "header_again")]
    assert sum(kinds) > count // 50
    assert min(kinds) > 20 or count < 1000
    assert not failures, f"seed {seed}: {failures[:5]}"
