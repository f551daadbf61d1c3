"""The last word: who may move the robot (operator), whose command counts (arbiter), what of it is safe (guard)."""
