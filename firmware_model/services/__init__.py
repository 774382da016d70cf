"""What the vehicle offers over the link: commands, parameters, setpoints, files, telemetry."""
