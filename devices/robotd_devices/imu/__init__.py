"""Inertial units on I2C."""

from robotd_devices.imu.mpu6050 import Mpu6050, Mpu6050Config

__all__ = ["Mpu6050", "Mpu6050Config"]
