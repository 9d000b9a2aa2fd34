"""What the parsers of laps return: rows as they stand in the file, in one form for all kinds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

# Columns of the inertial sensors in their order in every file: canonical name -> name in files, lower case.
IMU_COLUMNS = {
    "acc_x_mps2": "accx",
    "acc_y_mps2": "accy",
    "acc_z_mps2": "accz",
    "gyro_x_radps": "gyrox",
    "gyro_y_radps": "gyroy",
    "gyro_z_radps": "gyroz",
    "mag_x_ut": "magx",
    "mag_y_ut": "magy",
    "mag_z_ut": "magz",
    "azimuth_rad": "azimuth",
    "pitch_rad": "pitch",
    "roll_rad": "roll",
}


@dataclass(frozen=True, eq=False)
class Lap:
    """One lap of one device as its file has it: nothing dropped, nothing repaired, missing still 0.

    Args:
        path: The file.
        sets: One row per reading set in file order, index 0…T-1: ``line`` of the file; ``t_ms`` since the
            first set; ``x_m`` and ``y_m``, ground truth or NaN; the inertial columns of ``IMU_COLUMNS``.
        readings: One row per access point and set: ``set`` (index of ``sets``), ``mac``, ``range_m``,
            ``std_m``, ``rss_dbm``; a cleaned lap has ``true_distance_m`` too.
        is_slant: True where ``range_m`` is the range in space, False where it is projected to the plan.
    """

    path: Path
    sets: pd.DataFrame
    readings: pd.DataFrame
    is_slant: bool
