"""Reads scans through pyrplidarsdk (the vendor's own C++): port, baud, number of scans."""

import json
import sys
import time

import pyrplidarsdk

port, baud, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
driver = pyrplidarsdk.RplidarDriver(port=port, baudrate=baud)
if not driver.connect():
    raise SystemExit("connect")
info, health = driver.get_device_info(), driver.get_health()
if not driver.start_scan():
    raise SystemExit("start_scan")
scans, until = [], time.monotonic() + 10.0
while len(scans) < count and time.monotonic() < until:
    scan = driver.get_scan_data()
    if scan:
        angles, ranges, _ = scan
        scans.append([[float(a) for a in angles], [float(r) for r in ranges]])
driver.stop_scan()
driver.disconnect()
print(json.dumps({"model": info.model, "health": int(health.status), "scans": scans}))
