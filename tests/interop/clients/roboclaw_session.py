"""Drives a RoboClaw through tcr-roboclaw: port. Prints what each call returned."""

import json
import sys
import time

from tcr_roboclaw import Roboclaw

claw = Roboclaw(sys.argv[1], 38400)
claw.open()
told = {
    "version": claw.ReadVersion(),
    "set_timeout": claw.SetSerialTimeout(255),
    "timeout": claw.ReadSerialTimeout(),
    "set_counts": [claw.SetEncM1(1000), claw.SetEncM2(2000)],
    "speed": claw.SpeedM1M2(2000, -1000),
}
time.sleep(0.5)
told["counts"] = [claw.ReadEncM1(), claw.ReadEncM2()]
told["battery"] = claw.ReadMainBatteryVoltage()
told["currents"] = claw.ReadCurrents()
told["status"] = claw.ReadError()
told["duty"] = claw.DutyM1M2(0, 0)
print(json.dumps(told))
