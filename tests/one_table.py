"""A flight log as another vehicle's logger would write it: one CSV table, and its column map.

python tests/one_table.py FOLDER FLIGHT.csv MAP.toml     FOLDER: of `trimtab log export`
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

POSE = (*(f"p_ned_m_{i}" for i in range(3)), *(f"q_ned_frd_{i}" for i in range(4)))
CONTROL = (*(f"motor_mean_{i}" for i in range(4)), *(f"gyro_mean_rad_s_{i}" for i in range(3)))
COLUMNS = f"""
world = "ned"
body = "frd"
time = "t_us"
time_unit = "us"
position_m = {list(POSE[:3])}
quaternion = {list(POSE[3:])}
motor_command = {list(CONTROL[:4])}
gyro = {list(CONTROL[4:])}
"""
POSE_US = 10_000
"""Time between two poses, and of a mean in the control telemetry, which is stamped at its end."""


def one_table(folder: Path, target: Path) -> None:
    """Join the tables of a log to one at the times of the poses, as another vehicle's logger writes it."""
    poses, control = (
        {round(int(row["publish_time_us"]), -3): row for row in csv.DictReader((folder / name).open())}
        for name in ("mocap-pose.csv", "fc-control.csv")
    )
    with target.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t_us", *POSE, *CONTROL])
        for t_us, pose in sorted(poses.items()):
            mean = control.get(t_us + POSE_US)
            if mean is not None and mean["interval_us"] == str(POSE_US):
                writer.writerow([t_us, *(pose[key] for key in POSE), *(mean[key] for key in CONTROL)])


if __name__ == "__main__":
    one_table(Path(sys.argv[1]), Path(sys.argv[2]))
    Path(sys.argv[3]).write_text(COLUMNS)
