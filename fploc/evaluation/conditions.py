"""Conditions of records that studies vary: ``calibration: none``, ``access points: 4``, ``survey error: 0.5 m``."""

from __future__ import annotations

CALIBRATION, ACCESS_POINTS, SURVEY_ERROR = "calibration", "access points", "survey error"
STUDIES = (CALIBRATION, ACCESS_POINTS, SURVEY_ERROR)
AS_IS = "as they are"
"""Value of ``ACCESS_POINTS`` of records with all of them, to compare others of the study with."""


def condition(study: str, value: str) -> str:
    """Return the condition of records of a study."""
    return f"{study}: {value}"


def varied(named: str) -> tuple[str, str]:
    """Return study and value of a condition; two empty strings for one of no study."""
    study, _, value = named.partition(": ")
    return (study, value) if study in STUDIES else ("", "")


def is_studied(named: str) -> bool:
    """Return whether a condition is one of a study."""
    return varied(named) != ("", "")
