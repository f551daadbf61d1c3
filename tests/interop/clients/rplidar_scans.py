"""Reads scans through PyPI's rplidar: port, number of scans."""

import json
import sys

from rplidar import RPLidar

lidar = RPLidar(sys.argv[1], baudrate=115200)
info, health = lidar.get_info(), lidar.get_health()
lidar.start_motor()
points = []
for number, scan in enumerate(lidar.iter_scans()):
    points += [[angle, mm] for _, angle, mm in scan]
    if number + 1 >= int(sys.argv[2]):
        break
lidar.stop()
lidar.stop_motor()
lidar.disconnect()
print(json.dumps({"model": info["model"], "health": health[0], "points": points}))
