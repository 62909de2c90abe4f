"""Readings of the distance sensor from recordings."""

from collections.abc import Iterator, Sequence

import numpy as np

from twinline.arrays import FloatArray
from twinline.geometry.nominal import TofUnit
from twinline.recording.pass_reader import Recording
from twinline.recording.telemetry_table import TelemetryTable
from twinline.recording.tof import TofTable

_RESTART_S = 1.0


def recorded_unit(recordings: Sequence[Recording]) -> TofUnit | None:
    """Unit of the readings; None where there are none."""
    for recording in recordings:
        if recording.tof:
            return recording.tof[0].unit
        if recording.header.kind == "tof" and len(recording.telemetry):
            return "adc"
    return None


def recorded_readings(recordings: Sequence[Recording]) -> TofTable | None:
    """Readings of a ToF pass: those with a position of their own, else the telemetry's; None where there are none.

    The telemetry's times are the board's, exact to a microsecond, moved as a whole to host time: what counts for a
    sensor that lags is how far apart its readings are.
    """
    unit = recorded_unit(recordings)
    if unit is None:
        return None
    parts: list[FloatArray] = []
    first: Recording | None = None
    for recording in recordings:
        if recording.tof:
            rows = np.array([(r.time_s, r.cart_mm, r.slide_mm, r.reading) for r in recording.tof if r.unit == unit]).T
        elif recording.header.kind == "tof" and unit == "adc" and len(recording.telemetry):
            legs = [_without_invalid(leg, recording.header.adc_valid) for leg in _legs(recording.telemetry)]
            rows = np.concatenate(legs, axis=1)
            rows[3] /= recording.header.adc_per_count
        else:
            continue
        first = first or recording
        rows[0] += recording.shift_from(first)
        parts.append(rows)
    time_s, cart_mm, slide_mm, reading = np.concatenate(parts, axis=1)
    order = np.argsort(time_s, kind="stable")
    return TofTable(time_s[order], cart_mm[order], slide_mm[order], reading[order], unit)


def _without_invalid(rows: FloatArray, valid: tuple[float, float] | None) -> FloatArray:
    """Make NaN what is no reading, and its neighbours: each is a mean over the time since the one before."""
    if valid is None:
        return rows
    invalid = ~((rows[3] >= valid[0]) & (rows[3] <= valid[1]))
    spoiled = invalid.copy()
    spoiled[1:] |= invalid[:-1]
    spoiled[:-1] |= invalid[1:]
    rows[3, spoiled] = np.nan
    return rows


def _legs(table: TelemetryTable) -> Iterator[FloatArray]:
    """Time, cart, slide and sample as (4, k), between restarts of the board."""
    offset = table.host_time_s - table.board_time_s
    cuts = np.flatnonzero((np.diff(table.board_time_s) <= 0) | (np.abs(np.diff(offset)) > _RESTART_S)) + 1
    for rows in np.split(np.arange(len(table)), cuts):
        time_s = table.board_time_s[rows]
        columns = np.stack([time_s, table.cart_mm[rows], table.slide_mm[rows], table.adc[rows].astype(np.float64)])
        yield _with_earlier(columns, table, rows) + np.array([[float(np.median(offset[rows]))], [0.0], [0.0], [0.0]])


def _with_earlier(
    columns: FloatArray, table: TelemetryTable, rows: np.ndarray[tuple[int], np.dtype[np.intp]]
) -> FloatArray:
    """Put the samples that came with each line between it and the line before, where that line is known."""
    parts = [columns[:, :1]]
    for place in range(1, len(rows)):
        here = int(rows[place])
        earlier = table.earlier_adc[here]
        lines = int(table.n[here] - table.n[here - 1])
        if earlier and lines >= 1:
            before, after = columns[:, place - 1], columns[:, place]
            # With lines lost in between, the samples lie in the last of the equal steps from line to line.
            shares = 1.0 - (1.0 - np.arange(1, len(earlier) + 1) / (len(earlier) + 1)) / lines
            between = before[:, None] + (after - before)[:, None] * shares
            between[3] = earlier
            parts.append(between)
        parts.append(columns[:, place : place + 1])
    return np.concatenate(parts, axis=1)
