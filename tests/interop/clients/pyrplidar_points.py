"""Reads points through pyrplidar: port, baud, express mode (0: standard), number of points."""

import itertools
import json
import sys
import time

from pyrplidar import PyRPlidar

port, baud, mode, count = sys.argv[1], *map(int, sys.argv[2:5])
lidar = PyRPlidar()
lidar.connect(port=port, baudrate=baud, timeout=3)
info = lidar.get_info()
lidar.set_motor_pwm(500)
generator = lidar.start_scan_express(mode) if mode else lidar.start_scan()
points = [[m.angle, m.distance] for m in itertools.islice(generator(), count)]
lidar.stop()
time.sleep(0.1)
lidar.set_motor_pwm(0)
lidar.disconnect()
print(json.dumps({"model": info.model, "points": points}))
