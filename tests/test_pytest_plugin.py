"""The pytest plugin: each test runs a small test suite in a separate pytest process."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import xbus

ROOT = Path(__file__).parent.parent
PLUGIN = "xbus.pytest_plugin"


def run_pytest(folder: Path, text: str, *args: str) -> tuple[int, str]:
    """Exit status and output of pytest on a file with this text."""
    (folder / "test_driver.py").write_text(text)
    done = subprocess.run(  # noqa: S603 - pytest itself
        [sys.executable, "-m", "pytest", "-p", PLUGIN, "--strict-markers", "-q", *args],
        cwd=folder,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


#: A driver that does not use xbus: what GoToConfig and ReqProductCode are answered with.
DRIVER = """\
import pytest, serial

def ask(port, request):
    port.write(bytes.fromhex(request))
    reply = bytes.fromhex(request)[2] + 1
    while True:
        port.read_until(b"\\xfa\\xff")
        mid, size = port.read(2)
        payload = port.read(size + 1)[:-1]
        if mid == reply:
            return payload

def product_code(port, **options):
    with serial.serial_for_url(port, timeout=10, **options) as opened:
        ask(opened, "FA FF 30 00 D1")
        return ask(opened, "FA FF 1C 00 E5").decode().strip()
"""


def test_fixtures_in_a_suite_of_others(tmp_path: Path) -> None:
    status, output = run_pytest(
        tmp_path,
        DRIVER
        + """
def test_default(xbus_device):
    assert product_code(xbus_device.port).startswith("MTi-630-")
    assert xbus_device.device.state.value == "config"

@pytest.mark.xbus_device("MTi-680G", device_id=0x80001234, baudrate=460800)
def test_marker(xbus_device):
    assert product_code(xbus_device.port, baudrate=460800).startswith("MTi-680G-")
    assert xbus_device.device.identity.device_id == 0x80001234

@pytest.mark.xbus_device("MTi-3", tcp=True)
def test_tcp(xbus_device):
    assert xbus_device.port.startswith("socket://127.0.0.1:")
    assert product_code(xbus_device.port).startswith("MTi-3-")

@pytest.mark.xbus_device("MTi-300", output_configuration={"acceleration": 400, "rate_of_turn": 400})
def test_output_configuration(xbus_device):
    assert [output.quantity for output in xbus_device.device.settings.output_configuration] == [
        "acceleration", "rate_of_turn"
    ]
    with serial.Serial(xbus_device.port, timeout=10) as port:
        sample = port.read_until(b"\\xfa\\xff\\x36")
        assert sample

@pytest.mark.xbus_device("MTi-3")
class TestClass:
    def test_marker_of_a_class(self, xbus_device):
        assert xbus_device.device.product.name == "MTi-3"

def test_several(make_xbus_device):
    one, other = make_xbus_device("MTi-3"), make_xbus_device("MTi-710", speed=2)
    assert product_code(one.port).startswith("MTi-3-")
    assert product_code(other.port).startswith("MTi-G-710-")
""",
    )
    assert status == 0, output
    assert "6 passed" in output


def test_faults_and_the_plug(tmp_path: Path) -> None:
    status, output = run_pytest(
        tmp_path,
        DRIVER
        + """
import time
import xbus

@pytest.mark.xbus_device(faults=xbus.Faults(drop=1), output_configuration={"acceleration": 100})
def test_faults_begin_after_the_set_up(xbus_device):
    with serial.Serial(xbus_device.port, timeout=0.2) as port:
        assert port.read(1) == b""
        xbus_device.device.faults = None
        port.timeout = 10
        assert port.read(1)

def test_a_plug_comes_back_at_the_same_path(xbus_device):
    with serial.Serial(xbus_device.port, timeout=10) as port:
        assert port.read(1)
        xbus_device.device.unplug()
        with pytest.raises((serial.SerialException, OSError)):
            while True:
                port.read(1000)
    xbus_device.device.plug()
    for _ in range(100):
        try:
            assert product_code(xbus_device.port).startswith("MTi-630-")
            return
        except serial.SerialException:
            time.sleep(0.05)
    raise AssertionError("the port did not come back")
""",
    )
    assert status == 0, output


def test_a_wrong_option_fails_the_test_that_has_it(tmp_path: Path) -> None:
    status, output = run_pytest(
        tmp_path,
        """
import pytest

@pytest.mark.xbus_device("MTi-5")
def test_product(xbus_device):
    pass

@pytest.mark.xbus_device(output_configuration={"lat_lon": 100})
def test_output(xbus_device):
    pass

def test_after(xbus_device):
    pass
""",
    )
    assert status == 1
    assert "no product is called 'MTi-5'" in output
    assert "MTi-630" in output
    assert "1 passed, 2 errors" in output


def test_the_page_runs(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "howto" / "ci.md").read_text()
    section = page.partition("## With pytest\n")[2].partition("\n## ")[0]
    blocks = re.findall(r"^```python\n(.*?)^```", section, re.MULTILINE | re.DOTALL)
    driver = DRIVER + "\n\ndef read_product_code(port):\n    return product_code(port)\n\n"
    status, output = run_pytest(tmp_path, driver + "\n".join(blocks))
    assert status == 0, output
    assert f"{section.count('def test_')} passed" in output


def test_the_fixtures_are_listed(tmp_path: Path) -> None:
    _, output = run_pytest(tmp_path, "", "--fixtures", "--markers")
    assert "xbus_device(product='MTi-630'" in output
    _, output = run_pytest(tmp_path, "", "--fixtures")
    assert "A virtual MTi on a serial port" in output


def test_a_suite_without_devices_imports_nothing(tmp_path: Path) -> None:
    status, output = run_pytest(
        tmp_path,
        """
import sys

def test_imports():
    loaded = {name.partition(".")[0] for name in sys.modules}
    assert not loaded & {"numpy", "serial"}
    assert "xbus.sim" not in sys.modules
""",
    )
    assert status == 0, output


def test_pytest_finds_the_plugin(tmp_path: Path) -> None:
    """With the entry points of pyproject.toml, as an installed xbus has them."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    site, suite = tmp_path / "site", tmp_path / "suite"
    info = site / "xbus_mti-0.dist-info"
    info.mkdir(parents=True)
    suite.mkdir()
    # The package under test, with its extension module: the source folder has none if xbus is installed.
    (site / "xbus").symlink_to(Path(xbus.__file__).parent)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: xbus-mti\nVersion: 0\n")
    lines = [f"{name} = {target}\n" for name, target in project["entry-points"]["pytest11"].items()]
    (info / "entry_points.txt").write_text("".join(["[pytest11]\n", *lines]))
    (suite / "test_driver.py").write_text("def test_driver(xbus_device):\n    pass\n")
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "pytest", "-q"],
        cwd=suite,
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_nothing_else_is_needed() -> None:
    """pytest is no dependency of xbus: without pytest nothing imports the plugin."""
    code = "import sys; sys.modules['pytest'] = None; import xbus; xbus.sim"
    subprocess.run([sys.executable, "-c", code], check=True)  # noqa: S603


@pytest.mark.parametrize("name", ["xbus_device", "make_xbus_device"])
def test_a_fixture_is_documented(name: str) -> None:
    assert f"`{name}`" in (ROOT / "docs" / "howto" / "ci.md").read_text()
