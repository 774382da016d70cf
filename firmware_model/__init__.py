"""The vehicle's firmware in Python: a flight MCU and a radio MCU that see nothing but bytes and sensors."""
