"""Services of the vehicle over the link: commands, parameters, setpoints, files, telemetry."""
