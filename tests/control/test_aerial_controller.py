"""A unit's controller ignores stale reports of other units."""

from dataclasses import replace

import numpy as np
import pytest

from skyherd.control import AerialController, Hover, SafetyRadius, Template


class Eavesdropper(SafetyRadius):
    """Selection policy that records the reports it receives."""

    def choose(self, seen, reports, *others):
        """Record the senders, and choose as usual."""
        self.senders = [report.unit_id for report in reports]
        return super().choose(seen, reports, *others)


@pytest.mark.parametrize(("age_s", "senders"), [(0.0, [1]), (1.99, [1]), (2.01, []), (50.0, [])])
def test_controller_ignores_stale_reports(make_detections, make_report, age_s, senders) -> None:
    """The lifetime of a report is 2 s."""
    points, ids = np.array([300, 400, 300 + 100j]), np.arange(3)
    policy = Eavesdropper(radius=1.5)
    unit = AerialController(Template(ids, points), policy, Hover(), report_lifetime_s=2.0)
    report = replace(make_report(1, ids, points, [0, 1]), time_s=100.0 - age_s)
    unit.step(make_detections(ids, points, time_s=100.0), [report])
    assert policy.senders == senders
