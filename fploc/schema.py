"""The tables of a packed site: column, dtype, unit, null rule, meaning.

This module is the single source of the data contract (docs/data.md and croissant.json are made from it).
"""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd
import pandera.pandas as pa

from fploc.errors import BadFileError

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Column:
    """One column of a packed table."""

    name: str
    dtype: str
    unit: str
    meaning: str
    nullable: bool = False
    minimum: float | None = None
    maximum: float | None = None


@dataclass(frozen=True)
class Table:
    """One packed table: its columns in order, and the columns that identify a row."""

    name: str
    meaning: str
    columns: tuple[Column, ...]
    key: tuple[str, ...]

    def check(self, frame: pd.DataFrame, source: str) -> pd.DataFrame:
        """Return ``frame`` where it keeps the contract.

        Raises:
            BadFileError: Naming ``source``, the column and the first offending value.
        """
        try:
            return _pandera_schema(self).validate(frame)
        except pa.errors.SchemaError as error:
            cases = error.failure_cases
            value = cases["failure_case"].iloc[0] if isinstance(cases, pd.DataFrame) else cases
            column = getattr(error.schema, "name", None) or self.name
            raise BadFileError(
                source,
                f"table {self.name}, column {column}",
                value=value,
                expected=f"what fploc.schema says of it ({error.check})",
                way_out="rebuild the packed site with `fploc data build`",
            ) from error


def _pandera_schema(table: Table) -> pa.DataFrameSchema:
    columns = {}
    for column in table.columns:
        checks = []
        if column.minimum is not None:
            checks.append(pa.Check.ge(column.minimum))
        if column.maximum is not None:
            checks.append(pa.Check.le(column.maximum))
        columns[column.name] = pa.Column(column.dtype, checks=checks, nullable=column.nullable, required=True)
    return pa.DataFrameSchema(columns, strict=True, ordered=True, unique=list(table.key), name=table.name)


_DEVICE = Column("device", "int8", "1", "1 = files '13', 2 = files '24'", minimum=1, maximum=2)
_RECORDING = Column("recording", "str", "", "name of the lap's file, for example 713")
_INTERVAL = Column("interval", "int32", "1", "index of the reading set in its recording", minimum=0)
_TIME = Column("t_ms", "float64", "ms", "time since the start of the recording", minimum=0)

_RANGE_STD = Column(
    "range_std_m", "float64", "m", "the phone's own spread of the burst", nullable=True, minimum=0
)
_RSS = Column("rss_dbm", "float64", "dBm", "received signal strength", nullable=True, minimum=-120, maximum=0)


def _imu(name: str, unit: str, meaning: str) -> Column:
    return Column(name, "float64", unit, meaning, nullable=True)


READINGS = Table(
    name="readings",
    meaning="one row per access point heard in an interval",
    columns=(
        _DEVICE,
        _RECORDING,
        _INTERVAL,
        _TIME,
        Column("mac", "str", "", "BSSID of the access point"),
        Column(
            "range_slant_m",
            "float64",
            "m",
            "RTT range in space, no offset removed; null: no range",
            nullable=True,
            minimum=0,
            maximum=100,
        ),
        Column(
            "range_plan_m",
            "float64",
            "m",
            "the same projected to the plan, no offset removed",
            nullable=True,
            minimum=0,
            maximum=100,
        ),
        _RANGE_STD,
        _RSS,
        Column("is_far", "bool", "", "the range exceeds 60 m: kept, to be distrusted"),
    ),
    key=("device", "recording", "interval", "mac"),
)

INTERVALS = Table(
    name="intervals",
    meaning="one row per de-duplicated reading set of a device",
    columns=(
        _DEVICE,
        _RECORDING,
        _INTERVAL,
        _TIME,
        Column("x_published_m", "float64", "m", "ground truth as published, site frame", nullable=True),
        Column("y_published_m", "float64", "m", "ground truth as published, site frame", nullable=True),
        Column("x_repaired_m", "float64", "m", "ground truth after repair, site frame", nullable=True),
        Column("y_repaired_m", "float64", "m", "ground truth after repair, site frame", nullable=True),
        _imu("acc_x_mps2", "m/s^2", "acceleration, phone frame"),
        _imu("acc_y_mps2", "m/s^2", "acceleration, phone frame"),
        _imu("acc_z_mps2", "m/s^2", "acceleration, phone frame"),
        _imu("gyro_x_radps", "rad/s", "turn rate, phone frame"),
        _imu("gyro_y_radps", "rad/s", "turn rate, phone frame"),
        _imu("gyro_z_radps", "rad/s", "turn rate, phone frame"),
        _imu("mag_x_ut", "uT", "magnetic field, phone frame"),
        _imu("mag_y_ut", "uT", "magnetic field, phone frame"),
        _imu("mag_z_ut", "uT", "magnetic field, phone frame"),
        _imu("azimuth_rad", "rad", "Android orientation"),
        _imu("pitch_rad", "rad", "Android orientation"),
        _imu("roll_rad", "rad", "Android orientation"),
    ),
    key=("device", "recording", "interval"),
)

DEVICE_LINKS = Table(
    name="device_links",
    meaning="one row per range measured between device 1 and device 2",
    columns=(
        Column("lap", "str", "", "folder of the link log: lap 7 belongs to recordings 713 and 724"),
        _TIME,
        Column(
            "range_m",
            "float64",
            "m",
            "RTT range between the devices, no offset removed",
            nullable=True,
            minimum=0,
            maximum=100,
        ),
        _RANGE_STD,
        _RSS,
    ),
    key=("lap", "t_ms"),
)

TABLES = (READINGS, INTERVALS, DEVICE_LINKS)
