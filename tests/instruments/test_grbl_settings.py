"""What GRBL's settings put in doubt, by the figures of its own documentation."""

from __future__ import annotations

import pytest

from calrig.instruments.stages.grbl.settings import ACCELERATION, RATE, STEPS, ControllerSettings


@pytest.mark.parametrize(("rate_per_min", "is_too_fast"), [(17_900.0, False), (18_100.0, True)])
def test_more_than_30_khz_of_steps_are_in_doubt(rate_per_min, is_too_fast):
    """100 steps a degree: 30 kHz, which GRBL's README gives as its most, are 18,000 degrees a minute."""
    settings = ControllerSettings({STEPS: 100.0, RATE: rate_per_min, ACCELERATION: 50.0}, 0)
    assert any("kHz" in warning for warning in settings.warnings) is is_too_fast
