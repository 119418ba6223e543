"""What no fault in the lines, and no kill, may do to a set point."""

import secrets

from faults.streams import inject


def test_no_fault_makes_a_step_or_an_end_that_is_not_safe():
    seed = secrets.randbelow(2**31)
    ran, drawn, failures = inject(1000, seed)
    assert ran == 1000
    assert min(drawn[name] for name in ("stamp_ahead", "kill", "spike", "header_again")) > 20
    assert not failures, f"seed {seed}: {failures[:5]}"
