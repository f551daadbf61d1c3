"""For authors of plugins and drivers: virtual time, small worlds, a link that collects, and the contract as checks.

    from robotd.testing import check_behaviour, corridor_scan, run_virtual

Nothing here needs pytest: a failed check is an AssertionError that names what is wrong and the mend.
"""

from robotd.testing.device_checks import check_actuator, check_sensor
from robotd.testing.examples import example_message, example_view
from robotd.testing.failure import CheckFailed
from robotd.testing.links import AmbientClock, FakeLink, connected
from robotd.testing.plugin_checks import check_behaviour, check_perceptor
from robotd.testing.scans import box_scan, corridor_scan, open_scan
from robotd.testing.virtual import run_virtual, virtual_time
from robotd.world.clock import ManualClock

__all__ = [
    "AmbientClock",
    "CheckFailed",
    "FakeLink",
    "ManualClock",
    "box_scan",
    "check_actuator",
    "check_behaviour",
    "check_perceptor",
    "check_sensor",
    "connected",
    "corridor_scan",
    "example_message",
    "example_view",
    "open_scan",
    "run_virtual",
    "virtual_time",
]
