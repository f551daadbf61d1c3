"""A lidar's driver, its fake and the line in memory between them, for tests of faults on virtual time."""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any

import numpy as np

from robotd.authoring.device import Sensor
from robotd.testing import FakeLink
from robotd.world.messages import LidarScan
from robotd_devices.lidar.ld19_fake import BoxRoom
from robotd_devices.ports.memory_host import MemoryHost


class LidarBench:
    """What every such test looks at; a subclass makes driver, fake and line."""

    fake: Any
    lidar: Sensor[Any, LidarScan]
    line: MemoryHost
    link: FakeLink

    @property
    def faults(self) -> Counter[str]:
        return Counter(name for name, _ in self.link.faults)

    @property
    def scans(self) -> list[LidarScan]:
        return self.link.of(LidarScan)

    async def listen(self, scans: int) -> None:
        """Open it, wait for so many scans, close it."""
        await self.lidar.open()
        await self.link.received(scans)
        await self.lidar.close()


def now_s() -> float:
    """The loop's time."""
    return asyncio.get_running_loop().time()


def off_m(scan: LidarScan) -> np.ndarray:
    """How far each beam is from the room that the fakes stand in; nan where it says nothing."""
    off: np.ndarray = np.abs(scan.ranges_m - BoxRoom()(scan.angles_rad.astype(np.float64)))
    return off
