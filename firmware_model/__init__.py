"""Python model of the vehicle's firmware: a flight MCU and a radio MCU with bytes and sensors as inputs."""
