"""Measures the studio with 2 kHz acceleration, 1.6 kHz rate of turn and six plots in a browser.

    python benches/studio.py [SECONDS]

The device is another process on a pty, the studio is a third one, and Chromium draws the page Live without a
graphics card. The bench prints the frames per second of the plots, the processor time of the studio relative
to the elapsed time, and its memory. All plots must be drawn, the rates must be right, and no sample may be
lost.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from common import HIGH_RATE_OUTPUTS, processor_seconds, seconds_argument, virtual_device

OUTPUTS = HIGH_RATE_OUTPUTS | {
    "acceleration": 400,
    "rate_of_turn": 400,
    "magnetic_field": 100,
    "euler_angles": 400,
}
PLOTS = [name for name in OUTPUTS if name not in ("packet_counter", "sample_time_fine")]
#: Seconds until all plots are full.
WARM_UP = 15.0
#: Seconds between two readings.
STEP = 60.0
#: Counts what the plots draw: each clears its canvas once for a frame.
COUNT = """() => {
    window.frames_drawn = 0;
    const clear = CanvasRenderingContext2D.prototype.clearRect;
    CanvasRenderingContext2D.prototype.clearRect = function (...rectangle) {
        if (this.canvas.closest(".xbus-chart")) window.frames_drawn += 1;
        return clear.apply(this, rectangle);
    };
}"""


def memory(pid: int) -> float:
    """Returns the resident memory of a process, in MiB. Linux only."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def choose_plots(page: Page) -> None:
    """Shows `PLOTS` and no others."""
    page.locator(".xbus-chart canvas").first.wait_for()
    shown = page.locator(".xbus-chart .u-title").all_inner_texts()
    before = {title.split(" [")[0] for title in shown}
    page.get_by_role("combobox", name="plots").click()
    for name in sorted(before ^ set(PLOTS)):
        page.get_by_role("option", name=name, exact=True).click()
    page.keyboard.press("Escape")
    page.wait_for_function(
        "count => document.querySelectorAll('.xbus-chart').length === count", arg=len(PLOTS)
    )


def main() -> None:
    seconds = seconds_argument(60)
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with (
        virtual_device(OUTPUTS) as (device, _),
        tempfile.TemporaryDirectory() as folder,
        sync_playwright() as driver,
    ):
        port = device.link.name
        device.close()
        command = [sys.executable, "-m", "xbus", "studio", port, "--no-browser", "--port", "0"]
        command += ["--folder", folder]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as studio:
            assert studio.stdout is not None
            url = studio.stdout.readline().removeprefix("studio: ").strip()
            browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": 1280, "height": 1400})
            page.goto(f"{url}live")
            choose_plots(page)
            page.wait_for_timeout(1000 * WARM_UP)
            page.evaluate(COUNT)
            began, before = time.perf_counter(), processor_seconds(studio.pid)
            last, used, drawn = began, before, 0
            while (now := time.perf_counter()) - began < seconds:
                page.wait_for_timeout(1000 * min(STEP, began + seconds - now + 0.1))
                now, cpu = time.perf_counter(), processor_seconds(studio.pid)
                frames = page.evaluate("frames_drawn") / len(PLOTS)
                print(
                    f"{now - began:6.0f} s  {(frames - drawn) / (now - last):5.1f} frames/s  "
                    f"studio {(cpu - used) / (now - last):6.1%} of a core  {memory(studio.pid):.0f} MiB",
                    flush=True,
                )
                last, used, drawn = now, cpu, frames
            share = (used - before) / (last - began)
            table = page.locator(".xbus-table").first.inner_text()
            health = page.inner_text("body")
            browser.close()
            studio.send_signal(signal.SIGINT)
            assert studio.wait() == 0
    rates = {
        words[0]: float(words[1])
        for line in table.splitlines()
        if "_hr" in (words := line.split())[0]
    }
    assert abs(rates["acceleration_hr"] - 2000) < 20, rates
    assert abs(rates["rate_of_turn_hr"] - 1600) < 16, rates
    assert "no samples lost" in health, health
    print(f"studio, six plots   {drawn / (last - began):5.1f} frames/s  (goal: 20)")
    print(f"the same            {share:6.1%} of a core  (goal: 20 %)")


if __name__ == "__main__":
    main()
