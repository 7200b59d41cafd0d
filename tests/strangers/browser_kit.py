"""Debian's chromium without a window, driven by selenium: pages of ``dpstack web`` as a person meets them."""

from __future__ import annotations

import base64
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from tests.strangers.stranger_kit import HANGS_S, program

_FLAGS: Final = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-dev-shm-usage",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
)  # fmt: skip
#: tall pages are cut here in a picture
_HIGHEST: Final = 6000
#: every text on the page that is seen: [text, its colour, the colours behind it, font size in px, weight]
_TEXTS: Final = """
const seen = [];
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const text = walker.currentNode.data.trim();
  const node = walker.currentNode.parentElement;
  const box = node.getBoundingClientRect();
  const style = getComputedStyle(node);
  if (!text || box.width < 2 || box.height < 2 || style.visibility === "hidden") continue;
  if (node.closest("title, noscript, option, :disabled, .visually-hidden, .left-out")) continue;
  if (!node.checkVisibility({ opacityProperty: true })) continue;
  const behind = [];
  if (node instanceof SVGElement) {
    const shape = node.parentElement.querySelector(":scope > rect");
    if (shape && node.parentElement.tagName !== "svg") behind.push(getComputedStyle(shape).fill);
  }
  for (let one = node; one; one = one.parentElement) behind.push(getComputedStyle(one).backgroundColor);
  seen.push([text.slice(0, 40), node instanceof SVGElement ? style.fill : style.color, behind,
             parseFloat(style.fontSize), Number(style.fontWeight)]);
}
return seen;
"""


class Browser:
    """One browser with one window. ``width``, ``height`` in CSS pixels, by device emulation."""

    def __init__(self, folder: Path, width: int = 1280, height: int = 900) -> None:
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service

        options = webdriver.ChromeOptions()
        for flag in (*_FLAGS, f"--user-data-dir={folder / 'profile'}"):
            options.add_argument(flag)
        options.binary_location = program("chromium")
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver: Any = webdriver.Chrome(options=options, service=Service(program("chromedriver")))
        self.driver.set_script_timeout(HANGS_S)
        self.downloads = folder / "downloads"
        self.downloads.mkdir()
        self._command(
            "Browser.setDownloadBehavior", behavior="allow", downloadPath=str(self.downloads), eventsEnabled=False
        )
        self._command("Emulation.setFocusEmulationEnabled", enabled=True)
        self.window(width, height)

    def close(self) -> None:
        self.driver.quit()

    def _command(self, name: str, **arguments: object) -> Any:
        return self.driver.execute_cdp_cmd(name, arguments)

    def window(self, width: int, height: int = 900, *, dark: bool = False, calm: bool = False) -> None:
        """Emulate a device; ``calm``: its user wants less motion."""
        self._command(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )
        features = [("prefers-color-scheme", "dark" if dark else "light")]
        features += [("prefers-reduced-motion", "reduce")] if calm else []
        self._command("Emulation.setEmulatedMedia", features=[{"name": name, "value": one} for name, one in features])

    def open(self, url: str) -> None:
        """Open ``url`` as a new page, even where only its fragment differs."""
        self.driver.get("about:blank")
        self.driver.get(url)

    def go(self, route: str) -> None:
        """Go to a page of the page, for instance ``bus`` or ``slave/3``, and wait until it stands there."""
        self.js("location.hash = arguments[0]", f"#/{route}")
        self.until(lambda: self.js("return window.dpstack.path") == (route if "/" in route else f"{route}/"), route)

    def js(self, script: str, *arguments: object) -> Any:
        return self.driver.execute_script(script, *arguments)

    def module(self, script: str, *arguments: object) -> Any:
        """The value that an asynchronous function with the body ``script`` returns; it may import modules."""
        wrapped = (
            "const done = arguments[arguments.length - 1];"
            f"(async (...given) => {{ {script} }})(...[...arguments].slice(0, -1))"
            ".then((value) => done([true, value]), (error) => done([false, String(error)]));"
        )
        good, value = self.driver.execute_async_script(wrapped, *arguments)
        assert good, value
        return value

    def until(self, happened: Callable[[], Any], what: str = "") -> Any:
        """The first true value of ``happened``."""
        end = time.monotonic() + HANGS_S
        while not (found := happened()):
            assert time.monotonic() < end, f"not on the page: {what}; there is: {' | '.join(self.text('body').split())}"
            time.sleep(0.03)
        return found

    def until_js(self, wanted: object, script: str, *arguments: object) -> None:
        """Wait until ``script`` returns ``wanted``."""
        self.until(lambda: self.js(script, *arguments) == wanted, f"{wanted!r} by {script}")

    def text(self, css: str) -> str:
        """The text of the first element as a person sees it; "" where there is none."""
        return str(self.js("return document.querySelector(arguments[0])?.innerText ?? ''", css))

    def texts(self, css: str) -> list[str]:
        return list(self.js("return [...document.querySelectorAll(arguments[0])].map((one) => one.innerText)", css))

    def sees(self, text: str, css: str = "body") -> None:
        """Wait until ``text`` stands in the first element that ``css`` names."""
        self.until(lambda: text in self.text(css), f"{text!r} in {css}")

    def count(self, css: str) -> int:
        return int(self.js("return document.querySelectorAll(arguments[0]).length", css))

    def click(self, css: str) -> None:
        from selenium.webdriver.common.by import By

        self.until(lambda: self.count(css), css)
        self.driver.find_element(By.CSS_SELECTOR, css).click()

    def press(self, *keys: str) -> None:
        """Press keys one after the other: letters, or names of selenium's keys such as TAB, ENTER, ESCAPE, SPACE."""
        from selenium.webdriver.common.action_chains import ActionChains
        from selenium.webdriver.common.keys import Keys

        for key in keys:
            ActionChains(self.driver).send_keys(getattr(Keys, key) if len(key) > 1 else key).perform()

    def type(self, text: str) -> None:
        from selenium.webdriver.common.action_chains import ActionChains

        ActionChains(self.driver).send_keys(text).perform()

    def console(self) -> list[str]:
        """Errors and refusals that the browser has logged since the last call."""
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] not in ("INFO", "DEBUG")]

    def seen_texts(self) -> list[tuple[str, str, Sequence[str], float, int]]:
        return [tuple(one) for one in self.js(_TEXTS)]

    def picture(self, path: Path) -> None:
        """The whole page as a PNG, not only the part in the window."""
        width, height = self.js("return [innerWidth, Math.max(document.documentElement.scrollHeight, innerHeight)]")
        clip = {"x": 0, "y": 0, "width": width, "height": min(height, _HIGHEST), "scale": 1}
        taken = self._command("Page.captureScreenshot", captureBeyondViewport=True, clip=clip)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(base64.b64decode(taken["data"]))
