"""The RoboClaw fake proves itself: tcr-roboclaw, which other people wrote, drives and reads it unmodified."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from robotd_devices.motor.roboclaw_fake import RoboClawFake
from robotd_devices.ports.pty_host import PtyHost


def test_tcr_roboclaw(run_client: Any, tmp_path: Path) -> None:
    fake = RoboClawFake()
    fake.status = 0x080000
    with PtyHost(fake, tmp_path / "claw", baud=38_400):
        told = run_client("roboclaw_session.py", tmp_path / "claw")
        assert fake.speed_qpps(time.monotonic_ns()) == (0, 0)
    ok, version = told["version"]
    assert ok
    assert version.startswith("USB Roboclaw 2x7a v4.1.34")
    assert told["set_timeout"]
    assert told["timeout"] == [1, 255]
    assert told["set_counts"] == [True, True]
    assert told["speed"]
    assert told["duty"]
    (ok_1, count_1, _), (ok_2, count_2, status_2) = told["counts"]
    assert ok_1
    assert ok_2
    # 0.5 s and the time of the calls, in both directions alike
    assert 1900 < count_1 < 4000
    assert 2000 - count_2 == pytest.approx((count_1 - 1000) / 2, rel=0.2)
    assert status_2 & 0x02  # backwards
    assert told["battery"] == [1, 123]
    assert told["currents"] == [1, 50, 70]
    assert told["status"] == [1, 0x080000]
