"""What reading costs a sample, from bytes to scans, beside a pure-Python peer that decodes the same bytes."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import statistics
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Iterator
from typing import Any

from benches.harness import ROOT, Context
from robotd_devices.lidar.answers import AnswerReader, encode_descriptor
from robotd_devices.lidar.beam_sweep import BeamSweep
from robotd_devices.lidar.rplidar_capsules import FORMATS
from robotd_devices.lidar.rplidar_fake import RplidarFake
from robotd_devices.lidar.rplidar_reader import RplidarReader
from robotd_devices.lidar.rplidar_wire import SCAN, express_scan, motor_rpm, request
from robotd_devices.ports.pty_host import PtyHost
from robotd_devices.ports.serial_port import SerialSettings
from robotd_devices.ports.serial_raw import RawSerialPort

#: Bytes a read, as the commonest USB bridges hand them over.
CHUNK = 62
#: Bytes of a recording, many times what a port throws away when it is opened.
RECORDED, RECORDED_QUICK = 1 << 19, 1 << 17
_THROWN_AWAY = 1 << 15


def _recorded(model: str, mode: int, size: int) -> tuple[RplidarFake, int, bytes]:
    fake = RplidarFake(model)
    seconds = size * 10 / fake.model.baud
    fake.feed(motor_rpm(600) + (express_scan(mode) if mode else request(SCAN)), 0)
    head = AnswerReader(None)
    head.feed(fake.tick(round(seconds * 1e9)))
    assert head.descriptor is not None
    return fake, head.descriptor.kind, head.rest


def _ours(fake: RplidarFake, answer: int, data: bytes) -> float:
    """CPU microseconds a sample: parser, decoding, scans; the chunks come as on the wire."""
    byte_ns = 1e10 / fake.model.baud
    sweep = BeamSweep(beam_ns=fake.sample_ns, range_min_m=0.1, range_max_m=12.0)
    reader = RplidarReader(answer, sweep, byte_ns, 10.0)
    chunks = [data[at : at + CHUNK] for at in range(0, len(data), CHUNK)]
    samples, now_ns = 0, 0.0
    began = time.process_time()
    for chunk in chunks:
        now_ns += len(chunk) * byte_ns
        for scan in reader.feed(chunk, int(now_ns)):
            samples += len(scan.ranges_m)
    return (time.process_time() - began) / samples * 1e6


_WRITER = """
import os, sys
data, fd = open(sys.argv[1], "rb").read(), int(sys.argv[2])
while data:
    data = data[os.write(fd, data):]
sys.stdin.read()
"""


@contextlib.contextmanager
def _flat_out(data: bytes) -> Iterator[str]:
    """Path of a pty into which another process writes these bytes as fast as they are read."""
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        with tempfile.NamedTemporaryFile() as file:
            file.write(data)
            file.flush()
            command = [sys.executable, "-c", _WRITER, file.name, str(master)]
            with subprocess.Popen(command, stdin=subprocess.PIPE, pass_fds=(master,)) as writer:
                yield os.ttyname(slave)
                writer.kill()
    finally:
        os.close(master)
        os.close(slave)


def _ours_on_a_pty(fake: RplidarFake, answer: int, data: bytes) -> float:
    """CPU microseconds a sample from the pty to scans: the raw port on an event loop, then the reader."""
    sweep = BeamSweep(beam_ns=fake.sample_ns, range_min_m=0.1, range_max_m=12.0)
    reader = RplidarReader(answer, sweep, 1e10 / fake.model.baud, 10.0)

    async def read(path: str) -> float:
        samples, left, done = 0, len(data), asyncio.Event()

        def take(chunk: bytes) -> None:
            nonlocal samples, left
            left -= len(chunk)
            for scan in reader.feed(chunk, time.monotonic_ns()):
                samples += len(scan.ranges_m)
            if left <= _THROWN_AWAY:  # opening throws away what was there before
                done.set()

        port = RawSerialPort(SerialSettings(path, fake.model.baud), take, lambda reason: done.set())
        began = time.process_time()
        await port.open()
        await asyncio.wait_for(done.wait(), 60.0)
        took = time.process_time() - began
        port.abort()
        return took / samples * 1e6

    with _flat_out(data) as path:
        return asyncio.run(read(path))


def _pyrplidar() -> Any:
    """The module, from the folder of foreign clients that tests/interop makes; None where that is not there."""
    for site in sorted((ROOT / ".interop-venv").glob("*/pyrplidar.py")):
        sys.path.insert(0, str(site.parent))
        try:
            import pyrplidar  # type: ignore[import-not-found]
        finally:
            sys.path.remove(str(site.parent))
        return pyrplidar
    return None


def _theirs(module: Any, fake: RplidarFake, answer: int, mode: int, data: bytes) -> float:
    """CPU microseconds a sample from the pty to pyrplidar's measurements; it makes no scans."""
    form = FORMATS.get(answer)
    size, per = (form.size, form.samples) if form else (5, 1)
    count = (len(data) // size - 2) * per
    lidar = module.PyRPlidar()
    with _flat_out(encode_descriptor(size, answer, stream=True) + data) as path, contextlib.redirect_stdout(None):
        lidar.connect(path, fake.model.baud, 3)
        began = time.process_time()
        generator = lidar.start_scan_express(mode) if mode else lidar.start_scan()
        for _ in itertools.islice(generator(), count):
            pass
        took = time.process_time() - began
        lidar.disconnect()
    return took / count * 1e6


_SDK_CLIENT = """
import sys, time
import pyrplidarsdk
driver = pyrplidarsdk.RplidarDriver(port=sys.argv[1], baudrate=int(sys.argv[2]))
assert driver.connect() and driver.start_scan()
driver.get_scan_data()
samples, until, began = 0, time.monotonic() + float(sys.argv[3]), time.process_time()
while time.monotonic() < until:
    scan = driver.get_scan_data()
    samples += len(scan[0]) if scan else 0
print((time.process_time() - began) / samples * 1e6)
driver.stop_scan()
driver.disconnect()
"""


def _sdk(model: str, seconds: float) -> float | None:
    """CPU microseconds a sample of the vendor's SDK through pyrplidarsdk, on a pty at the pace of the line."""
    sites = sorted((ROOT / ".interop-venv").glob("*/pyrplidarsdk"))
    if not sites:
        return None
    fake = RplidarFake(model)
    baud = fake.model.baud
    with tempfile.TemporaryDirectory() as folder, PtyHost(fake, f"{folder}/lidar", baud=baud) as host:
        done = subprocess.run(
            [sys.executable, "-c", _SDK_CLIENT, str(host.link), str(baud), str(seconds)],
            env=os.environ | {"PYTHONPATH": str(sites[0].parent)},
            capture_output=True,
            text=True,
            timeout=60,
            check=True,
        )
    return float(done.stdout)


def measure(ctx: Context) -> None:
    """parse_us_per_sample_legacy and _capsule; rows for every mode."""
    size, rounds = (RECORDED_QUICK, 3) if ctx.quick else (RECORDED, 9)
    module = _pyrplidar()
    if module is None:
        ctx.note("no baseline of parsing: pytest tests/interop puts pyrplidar there")
    for model, mode in [("c1", 0), ("a1", 0), ("s2", 0), ("a1", 1), ("a1", 2), ("s2", 1), ("s3", 2)]:
        fake, answer, data = _recorded(model, mode, size)
        row: dict[str, Any] = {"what": "parse", "model": model, "answer": f"{answer:#x}", "peer_us": None}
        row["chunks_us"] = statistics.median(_ours(fake, answer, data) for _ in range(rounds))
        row["us"] = statistics.median(_ours_on_a_pty(fake, answer, data) for _ in range(rounds))
        if module is not None and answer != 0x86:  # which pyrplidar does not know
            row["peer_us"] = statistics.median(_theirs(module, fake, answer, mode, data) for _ in range(rounds))
        ctx.row(row)
    for model in ("c1", "a1-old", "a1", "s2", "s3"):
        ctx.row({"what": "sdk", "model": model, "sdk_us": _sdk(model, 1.0 if ctx.quick else 3.0)})
    rows = [row for row in ctx.rows.all if row.get("what") == "parse"]
    legacy = next(row for row in rows if row["answer"] == "0x81")
    express = next(row for row in rows if row["answer"] == "0x82")
    for name, row in (("parse_us_per_sample_legacy", legacy), ("parse_us_per_sample_capsule", express)):
        # in the chunks of a USB bridge or flat out, whichever costs more; the peer flat out, its best case
        ctx.figure(name, max(row["us"], row["chunks_us"]), baseline=row["peer_us"], runs=rounds)
