"""Reads points through lds2d: model, port, number of points."""

import itertools
import json
import sys

from lds2d import Lidar

model, port, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
lidar = Lidar.open(model, port)
try:
    lidar.start()
except Exception as error:
    if type(error).__name__ != "NotSupportedError":
        raise
points = [[p.angle_deg, p.dist_mm] for p in itertools.islice(lidar.points(), count)]
lidar.close()
print(json.dumps(points))
