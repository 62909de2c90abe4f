"""Whether everybody can read and use the page: both themes, the keyboard, a screen reader."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser.conftest import Server, opened
from tests.browser.picture import wait_for_points

SIZES = ((1440, 900), (1024, 768), (390, 844))
LEAST_CONTRAST = 4.5

# Every text that is seen, against the nearest ground that is not see-through (WCAG 2.2, 1.4.3).
FAINT_TEXTS = """least => {
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = colour => {
    canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = colour; canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const light = ([r, g, b]) => [r, g, b].map(v => v / 255)
    .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const ground = element => {
    for (let at = element; at; at = at.parentElement) {
      const colour = rgba(getComputedStyle(at).backgroundColor);
      if (colour[3] > 180) return colour;
    }
    return [255, 255, 255, 255];
  };
  const faint = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    const text = walker.currentNode.textContent.trim();
    const hidden = !element.checkVisibility() || element.closest(".visually-hidden, .skip, svg, noscript, script");
    if (!text || hidden) continue;
    const [one, two] = [light(rgba(getComputedStyle(element).color)), light(ground(element))];
    const contrast = (Math.max(one, two) + 0.05) / (Math.min(one, two) + 0.05);
    if (contrast < least) faint.push(`${text}: ${contrast.toFixed(2)}`);
  }
  return faint;
}"""

NAMELESS_CONTROLS = """() => [...document.querySelectorAll("button, a, input, select, summary, iframe")]
  .filter(element => !(element.getAttribute("aria-label") || element.title || element.textContent.trim()
    || element.labels?.length))
  .map(element => element.outerHTML)"""


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_both_themes_follow_the_system_and_can_be_read(
    browser: Browser, server: Server, scanned: Callable[[], dict[str, Any]], output: Path, theme: str
) -> None:
    scanned()
    grounds = {"light": "rgb(238, 241, 245)", "dark": "rgb(13, 16, 21)"}
    for width, height in SIZES:
        context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=theme)  # type: ignore[arg-type]
        page = opened(context, server)
        wait_for_points(page, at_least=0.003)
        expect(page.locator("body")).to_have_css("background-color", grounds[theme])
        assert page.evaluate(FAINT_TEXTS, LEAST_CONTRAST) == []
        too_wide = page.evaluate("document.documentElement.scrollWidth - innerWidth")
        assert too_wide <= 0, f"at {width} px the page is {too_wide} px too wide"
        page.screenshot(path=output / f"scan-{theme}-{width}.png")
        context.close()


def test_a_chosen_theme_outlasts_a_reload(page: Page) -> None:
    page.get_by_role("group", name="Theme").get_by_role("button", name="Dark").click()
    expect(page.locator("body")).to_have_css("background-color", "rgb(13, 16, 21)")
    page.reload()
    expect(page.locator("body")).to_have_css("background-color", "rgb(13, 16, 21)")
    page.get_by_role("group", name="Theme").get_by_role("button", name="As the system").click()
    expect(page.locator("body")).to_have_css("background-color", "rgb(238, 241, 245)")


def test_the_keyboard_reaches_everything_and_shows_where_it_is(page: Page) -> None:
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="Skip to the page")).to_be_focused()
    reached: list[str] = []
    for _ in range(60):
        page.keyboard.press("Tab")
        words, width = page.evaluate(
            "() => [(document.activeElement.textContent || document.activeElement.title).trim(),"
            " getComputedStyle(document.activeElement).outlineStyle]"
        )
        reached.append(words)
        in_page = page.evaluate(
            "document.activeElement !== document.body && document.activeElement.tagName !== 'IFRAME'"
        )
        assert not in_page or width != "none" or words == "", f"the focus on {words!r} cannot be seen"
        if "Reconstruct" in words:
            break
    for name in ("As the system", "Height", "Folder", "Settings", "Reconstruct"):
        assert any(name in words for words in reached), f"{name} cannot be reached: {reached}"


def test_every_control_has_a_name(page: Page) -> None:
    page.get_by_text("Settings").click()
    assert page.evaluate(NAMELESS_CONTROLS) == []


def test_progress_is_spoken_politely(page: Page) -> None:
    voice = page.locator("p[role=status]")
    expect(voice).to_have_attribute("aria-live", "polite")


def test_red_is_kept_for_laser_light_and_stop(page: Page) -> None:
    used = page.evaluate(
        """() => [...document.styleSheets].flatMap(sheet => [...sheet.cssRules]).map(rule => rule.cssText)
           .filter(text => /var\\(--red|var\\(--on-red/.test(text))"""
    )
    assert used == []
