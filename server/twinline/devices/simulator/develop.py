"""From light to grey levels, line by line: bed, patches, lasers, falloff of the lens, noise, eight bits."""

from typing import NamedTuple

import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.devices.simulator.compiled import loop, loop_in_any_order
from twinline.devices.simulator.noise_table import next_random
from twinline.devices.simulator.room_cells import BED
from twinline.devices.simulator.solids import OPEN_BED, TEXTURE_TEXELS, Solids

POOL_BITS = 17
_MASK = TEXTURE_TEXELS - 1


class RoomPicture(NamedTuple):
    """The room's light of one picture before it is put together.

    Attributes
    ----------
    texels : (rows, columns, 2) array of float32
        Where each pixel's ray meets the bed, in texels of its pattern, with the camera's foot point at 0; positive.
    foot : (2,) array of float32
        What is to be added for the cart's position; not negative.
    bed_dn : (3,) array of float32
        Grey levels of the bed in full light.
    light : (n, m) array
        The room's light at the corners of the cells.
    kinds, patch_of, patches
        See `twinline.devices.simulator.room_cells`.
    """

    texels: FloatArray
    foot: FloatArray
    bed_dn: FloatArray
    light: FloatArray
    kinds: IntArray
    patch_of: IntArray
    patches: FloatArray


@loop
def _room_line(
    solids: Solids, room: RoomPicture, row: int, shade: FloatArray, line: FloatArray
) -> None:  # pragma: no cover - compiled
    """Grey levels of one row by the light of the room, (3, columns) float32."""
    texture, grain, open_light = solids.texture, np.float32(solids.looks[0, 3]), solids.numbers[OPEN_BED]
    texels, light, kinds, patch_of, patches = room.texels, room.light, room.kinds, room.patch_of, room.patches
    columns, step = line.shape[1], patches.shape[1]
    i = row // step
    p = (row % step + 0.5) / step
    foot_x, foot_y = room.foot[0], room.foot[1]
    one, least = np.float32(1.0), np.float32(0.05)
    for column in range(columns):
        x, y = texels[row, column, 0] + foot_x, texels[row, column, 1] + foot_y
        # All is positive here, so that cutting off is rounding down.
        i0, j0 = np.int32(x), np.int32(y)
        a, b = x - np.float32(i0), y - np.float32(j0)
        i0, j0 = i0 & _MASK, j0 & _MASK
        i1, j1 = (i0 + 1) & _MASK, (j0 + 1) & _MASK
        near = texture[i0, j0] + (texture[i0, j1] - texture[i0, j0]) * b
        far = texture[i1, j0] + (texture[i1, j1] - texture[i1, j0]) * b
        shade[column] = max(one + grain * (near + (far - near) * a), least)
    for j in range(patch_of.shape[1]):
        if kinds[i, j] == BED:
            start = (light[i, j] * (1.0 - p) + light[i + 1, j] * p) / open_light
            end = (light[i, j + 1] * (1.0 - p) + light[i + 1, j + 1] * p) / open_light
            for column in range(j * step, min(j * step + step, columns)):
                shade[column] *= start + (end - start) * ((column - j * step + 0.5) / step)
    for channel in range(3):
        level = room.bed_dn[channel]
        for column in range(columns):
            line[channel, column] = level * shade[column]
    for j in range(patch_of.shape[1]):
        number = patch_of[i, j]
        if number >= 0:
            for column in range(j * step, min(j * step + step, columns)):
                for channel in range(3):
                    line[channel, column] = patches[number, row % step, column - j * step, channel]


@loop_in_any_order
def _expose_line(
    line: FloatArray,
    fall: FloatArray,
    light_gain: float,
    read_dn: float,
    dn_per_electron: float,
    starts: IntArray,
    pool: FloatArray,
    answer: ByteArray,
) -> None:  # pragma: no cover - compiled
    """Add noise to a line of light, (3, columns) float32, and write it as pixels, (columns, 3)."""
    read2 = np.float32(read_dn * read_dn)
    shot = np.float32(dn_per_electron)
    gain = np.float32(light_gain)
    half, top, zero = np.float32(0.5), np.float32(255.0), np.float32(0.0)
    for channel in range(3):
        noise = pool[starts[channel] : starts[channel] + line.shape[1]]
        for column in range(line.shape[1]):
            mean = line[channel, column] * gain * fall[column]
            value = mean + noise[column] * np.sqrt(read2 + shot * min(mean, top)) + half
            answer[column, channel] = np.uint8(min(max(value, zero), top))


@loop
def develop(
    solids: Solids,
    room: RoomPicture,
    bands: FloatArray,
    first_row: int,
    responses: FloatArray,
    slopes_x: FloatArray,
    slopes_y: FloatArray,
    falloff: float,
    light_gain: float,
    read_dn: float,
    dn_per_electron: float,
    seed: int,
    pool: FloatArray,
    scratch: FloatArray,
    starts: IntArray,
    picture: ByteArray,
) -> None:  # pragma: no cover - compiled
    """Make a picture.

    Parameters
    ----------
    bands : (n, rows, columns) array of float32
        Light of lasers, in the rows of the picture from ``first_row``; empty for none.
    responses : (n, 3) array
        Blue, green and red for one grey level of each band.
    slopes_x : (columns,) array of float32
        x/z of the columns' rays, near enough for the falloff; likewise ``slopes_y`` for the rows.
    falloff
        Share of the natural darkening towards the corners.
    light_gain
        Factor on all light.
    pool : (2**POOL_BITS + columns,) array of float32
        Normal random numbers.
    scratch : (5, columns) array of float32
    starts : (3,) array of int
        Scratch too.
    picture : (rows, columns, 3) array of uint8
        Answer: blue, green, red.
    """
    rows, columns, _ = picture.shape
    line, shade, fall = scratch[:3], scratch[3], scratch[4]
    fall[:] = np.float32(1.0)
    state = np.uint64(seed)
    for row in range(rows):
        _room_line(solids, room, row, shade, line)
        for n in range(bands.shape[0]):
            if not first_row <= row < first_row + bands.shape[1]:
                continue
            for channel in range(3):
                response = np.float32(responses[n, channel])
                if response > 0.0:
                    for column in range(columns):
                        line[channel, column] += response * bands[n, row - first_row, column]
        if falloff > 0.0:
            for column in range(columns):
                square = slopes_x[column] * slopes_x[column] + slopes_y[row] * slopes_y[row]
                dim = np.float32(1.0) + np.float32(falloff) * square
                fall[column] = np.float32(1.0) / (dim * dim)
        for channel in range(3):
            state = next_random(state)
            starts[channel] = np.int64(state >> np.uint64(64 - POOL_BITS))
        _expose_line(line, fall, light_gain, read_dn, dn_per_electron, starts, pool, picture[row])


@loop
def room_picture(
    solids: Solids,
    room: RoomPicture,
    scratch: FloatArray,
    picture: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Grey levels by the light of the room alone, (rows, columns, 3) float32, without falloff and noise."""
    line, shade = scratch[:3], scratch[3]
    for row in range(picture.shape[0]):
        _room_line(solids, room, row, shade, line)
        for column in range(picture.shape[1]):
            for channel in range(3):
                picture[row, column, channel] = line[channel, column]
