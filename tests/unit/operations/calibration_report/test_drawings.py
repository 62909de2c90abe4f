import re
import xml.etree.ElementTree as ET

import pytest

from twinline.operations.calibration_report.drawings import Axis, Plot, axis_over

NAN = float("nan")


def numbers(path: str) -> list[float]:
    return [float(n) for n in re.findall(r"-?\d+\.?\d*", path)]


class TestAxis:
    @pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-0.032, 0.041), (120.0, 980.0), (1e-4, 2e-4)])
    def test_ticks_are_a_few_round_numbers_within(self, low: float, high: float) -> None:
        ticks = Axis(low, high, "x").ticks()
        assert 2 <= len(ticks) <= 8
        assert all(low - 1e-9 <= value <= high + 1e-9 for value, _ in ticks)
        assert len({words for _, words in ticks}) == len(ticks)

    def test_a_logarithmic_axis_has_ticks_at_powers_of_ten(self) -> None:
        assert [words for _, words in Axis(0.02, 300.0, "x", log=True).ticks()] == ["0.1", "1", "10", "100"]

    def test_an_axis_over_nothing_and_over_one_value_can_be_drawn(self) -> None:
        for axis in (axis_over([], "x"), axis_over([NAN], "x"), axis_over([0.0, -1.0], "x", log=True)):
            assert axis.high > axis.low
        assert axis_over([5.0, 5.0], "x").low < 5.0 < axis_over([5.0, 5.0], "x").high

    def test_values_beyond_the_ends_stay_beside_the_frame(self) -> None:
        axis = Axis(0.0, 1.0, "x")
        assert -0.05 < axis.share(-1e9) < 0.0
        assert 1.0 < axis.share(1e9) < 1.05


class TestPlot:
    def plot(self) -> Plot:
        return Plot(Axis(0.0, 10.0, "x, mm"), Axis(0.0, 2.0, "y <mm>"), 'a "plot"')

    def test_it_is_well_formed_and_read_out_by_its_label(self) -> None:
        plot = self.plot()
        plot.line([0.0, 5.0, 10.0], [0.0, 1.0, 2.0], "line")
        plot.note(5.0, 1.0, "here <&", "remark")
        root = ET.fromstring(plot.svg())
        assert root.attrib["role"] == "img"
        assert root.attrib["aria-label"] == 'a "plot"'
        words = [element.text for element in root.iter("{http://www.w3.org/2000/svg}text")]
        assert "y <mm>" in words
        assert "here <&" in words

    def test_a_value_that_is_missing_interrupts_a_line(self) -> None:
        plot = self.plot()
        plot.line([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, NAN, 1.0], "line")
        assert len(plot.parts) == 2

    def test_larger_values_lie_higher_and_further_to_the_right(self) -> None:
        plot = self.plot()
        (x0, y0), (x1, y1) = plot.place(1.0, 0.5), plot.place(2.0, 1.5)
        assert x1 > x0
        assert y1 < y0

    def test_a_bar_ends_at_its_value(self) -> None:
        plot = self.plot()
        plot.bar(2.0, 4.0, 1.0, "bar")
        (bar,) = plot.parts
        x, y, width, height = (float(re.search(rf' {n}="([\d.]+)"', bar)[1]) for n in ("x", "y", "width", "height"))  # type: ignore[index]
        assert y == pytest.approx(plot.place(2.0, 1.0)[1], abs=0.1)
        assert y + height == pytest.approx(plot.place(2.0, 0.0)[1], abs=0.1)
        assert x + width / 2 == pytest.approx(plot.place(3.0, 0.0)[0], abs=0.2)
