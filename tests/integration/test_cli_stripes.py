"""``twinline stripes`` as a process: its CSV, its overlay, its summary, and what it says to bad input."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.integration.command_line import files_below, require_refusal, twinline

Bytes = NDArray[np.uint8]

SIZE = (200, 150)
SLOPE = 0.1


def picture(rows: tuple[float, ...] = (100.0, 40.0), *, seed: int = 3, red: float = 150.0) -> Bytes:
    """Slanted red stripes on a dark, noisy ground."""
    v, u = np.indices((SIZE[1], SIZE[0])).astype(float)
    light = sum((np.exp(-0.5 * ((v - row - SLOPE * u) / 1.5) ** 2) for row in rows), np.zeros_like(v))
    rgb = 30.0 + light[..., None] * np.array([0.1, 0.15, 1.0]) * red
    noisy = rgb + np.random.default_rng(seed).normal(0.0, 1.5, rgb.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)


def write(path: Path, image: Bytes) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_two_stripes_are_found_to_a_fraction_of_a_pixel(tmp_path: Path) -> None:
    image, table = write(tmp_path / "two.png", picture()), tmp_path / "two.csv"
    done = twinline("stripes", image, "-o", table)
    assert done.returncode == 0, done.stderr
    assert "along-u, laser 1: 200, laser 2: 200 of 200" in done.stdout
    assert table.read_text().splitlines()[0] == "image,laser,u,v,sd_px,amplitude,width_px,flags"
    rows = read(table)
    for laser, start in ((1, 100.0), (2, 40.0)):
        own = [row for row in rows if row["laser"] == str(laser)]
        u, v, sd = (np.array([float(row[name]) for row in own]) for name in ("u", "v", "sd_px"))
        error = v - start - SLOPE * u
        assert len(own) == SIZE[0]
        assert float(np.sqrt(np.mean(error**2))) < 0.05
        assert float(np.median(sd)) == pytest.approx(float(error.std()), rel=0.4)
        assert {row["image"] for row in own} == {str(image)}
        assert np.median([float(row["width_px"]) for row in own]) == pytest.approx(1.5, abs=0.1)


def test_stripes_along_v_are_told_by_themselves(tmp_path: Path) -> None:
    turned = write(tmp_path / "turned.png", np.ascontiguousarray(picture((70.0,)).transpose(1, 0, 2)))
    done = twinline("stripes", turned, "-o", tmp_path / "turned.csv", "--json")
    summary = json.loads(done.stdout)
    assert summary["output"] == str(tmp_path / "turned.csv")
    assert (summary["images"][0]["runs"], summary["images"][0]["found"]) == ("along-v", [200])
    rows = read(tmp_path / "turned.csv")
    assert float(rows[50]["u"]) == pytest.approx(75.0, abs=0.2)
    assert rows[50]["v"] == "50"


def test_several_pictures_share_a_table_and_the_overlay_shows_each(tmp_path: Path) -> None:
    images = [write(tmp_path / f"{n}.png", picture((60.0 + n,), seed=n)) for n in range(2)]
    done = twinline("stripes", *images, "-o", tmp_path / "both.csv", "--overlay", tmp_path / "drawn")
    assert done.returncode == 0, done.stderr
    assert {row["image"] for row in read(tmp_path / "both.csv")} == {str(image) for image in images}
    for n, image in enumerate(images):
        drawn = cv2.imread(str(tmp_path / "drawn" / image.name))
        assert drawn is not None
        v, u = np.nonzero((drawn == (0, 255, 0)).all(axis=2))
        assert len(u) == SIZE[0]
        assert np.abs(v - 60.0 - n - SLOPE * u).max() < 1.0


def test_a_laser_off_picture_removes_what_is_not_laser(tmp_path: Path) -> None:
    lamp = picture((110.0,), red=200.0)
    both = np.maximum(lamp, picture((40.0,), red=90.0))
    image, off = write(tmp_path / "on.png", both), write(tmp_path / "off.png", lamp)
    done = twinline("stripes", image, "-o", tmp_path / "laser.csv", "--off", off, "--json")
    assert json.loads(done.stdout)["images"][0]["found"] == [200]
    v = np.array([float(row["v"]) for row in read(tmp_path / "laser.csv")])
    np.testing.assert_allclose(v, 40.0 + SLOPE * np.arange(200), atol=0.5)


@pytest.mark.parametrize("method", ["gaussian", "centre-of-gravity", "steger", "brightest-pixel"])
def test_every_method_can_be_chosen(method: str, tmp_path: Path) -> None:
    image = write(tmp_path / "one.png", picture((60.0,)))
    assert twinline("stripes", image, "-o", tmp_path / "one.csv", "--method", method).returncode == 0
    rows = read(tmp_path / "one.csv")
    error = np.array([float(row["v"]) - 60.0 - SLOPE * float(row["u"]) for row in rows])
    assert len(rows) >= 190
    assert float(np.sqrt(np.mean(error**2))) < (0.6 if method == "brightest-pixel" else 0.2)


class TestBadInput:
    @pytest.fixture
    def image(self, tmp_path: Path) -> Path:
        return write(tmp_path / "good.png", picture())

    @pytest.fixture
    def results(self, tmp_path: Path) -> Path:
        (tmp_path / "results").mkdir()
        return tmp_path / "results"

    def refused(self, results: Path, *arguments: object, words: tuple[str, ...]) -> None:
        require_refusal(twinline("stripes", *arguments, "-o", results / "stripes.csv"), *words)
        assert files_below(results) == set()

    def test_a_picture_that_is_missing(self, image: Path, results: Path) -> None:
        gone = image.with_name("gone.png")
        self.refused(results, image, gone, words=(str(gone), "No such file"))

    def test_a_picture_that_is_truncated(self, image: Path, results: Path) -> None:
        image.write_bytes(image.read_bytes()[:3000])
        self.refused(results, image, words=(str(image), "truncated"))

    def test_a_picture_without_a_stripe(self, image: Path, results: Path) -> None:
        write(image, picture(()))
        self.refused(results, image, words=(str(image), "No laser stripe"))

    def test_a_laser_off_picture_of_another_size(self, image: Path, results: Path) -> None:
        off = write(image.with_name("off.png"), np.zeros((40, 60, 3), np.uint8))
        self.refused(results, image, "--off", off, words=(str(image), "60 x 40", "200 x 150"))

    @pytest.mark.parametrize(
        ("option", "value", "word"),
        [
            ("--method", "best", "steger"),
            ("--channel", "infrared", "luma"),
            ("--runs", "diagonal", "along-v"),
            ("--lasers", "3", "auto"),
            ("--noise", "1,2", "n,K,C"),
            ("--noise", "1,inf,-2", "speckle"),
        ],
    )
    def test_an_impossible_option(self, option: str, value: str, word: str, image: Path, results: Path) -> None:
        self.refused(results, image, option, value, words=(word,) if option == "--noise" else (value, word))

    def test_an_output_that_cannot_be_written(self, image: Path, tmp_path: Path) -> None:
        before = files_below(tmp_path)
        target = tmp_path / "no" / "stripes.csv"
        require_refusal(twinline("stripes", image, "-o", target), str(target), "no such file or directory")
        assert files_below(tmp_path) == before

    def test_a_colour_asked_of_a_grey_picture(self, image: Path, results: Path) -> None:
        write(image, picture()[..., 2])
        self.refused(results, image, "--channel", "red", words=(str(image), "one channel"))
