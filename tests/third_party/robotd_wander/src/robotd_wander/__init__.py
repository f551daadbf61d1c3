"""An outside plugin for robotd: the behaviour `wander` and the device `bumper`."""
