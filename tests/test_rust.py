"""Do the Rust tests pass? They run here so that one command runs every test."""

import os
import re
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

CRATE = Path(__file__).parents[1]
NEEDS_CARGO = "the Rust tests need cargo and the crate's sources"


@pytest.fixture(scope="module")
def cargo():
    path = shutil.which("cargo")
    if path is not None and (CRATE / "Cargo.toml").is_file():
        return path
    if os.environ.get("CI") == "true":
        pytest.fail(f"{NEEDS_CARGO}, and a check of the whole project must not leave them out")
    pytest.skip(NEEDS_CARGO)


def run_cargo(cargo, *arguments):
    """Run cargo, pass its lines on as they come, and give back the status and all lines."""
    process = subprocess.Popen(
        [cargo, *arguments],
        cwd=CRATE,
        env={**os.environ, "CARGO_TERM_COLOR": "never"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,  # so that a timeout ends the compilers too
    )
    lines = []
    try:
        for line in process.stdout:
            print(line, end="", flush=True)
            lines.append(line)
        return process.wait(), lines
    finally:
        process.stdout.close()
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def failure_of(lines):
    """The part of cargo's output that says what went wrong."""
    text = "".join(lines)
    for start in ("\nfailures:\n", "\nerror"):
        if start in text:
            return text[text.index(start) :].strip()
    return "".join(lines[-30:]).strip()


def passed_count(lines):
    """How many tests all of cargo's test binaries ran."""
    return sum(
        int(count) for count in re.findall(r"^test result: ok\. (\d+) passed", "".join(lines), re.M)
    )


@pytest.mark.timeout(1800)  # the first run compiles everything
def test_rust_suite_passes(cargo):
    # optimised, and with what draws on cards: so the libraries are built for the extension already
    status, lines = run_cargo(cargo, "test", "--locked", "--release", "--features", "gpu")
    if status != 0:
        pytest.fail(f"cargo test ended with {status}\n\n{failure_of(lines)}", pytrace=False)
    assert passed_count(lines) > 0, "cargo test ran no test"


def test_failure_shows_the_test_and_not_the_compiler():
    lines = [
        "   Compiling treelod\n",
        "test plant::tests::a ... FAILED\n",
        "\n",
        "failures:\n",
        "---- plant::tests::a stdout ----\n",
        "left: 1\n",
    ]
    assert failure_of(lines).splitlines() == [
        "failures:",
        "---- plant::tests::a stdout ----",
        "left: 1",
    ]
    lines = ["   Compiling treelod\n", "error[E0308]: mismatched types\n", " --> src/lib.rs:1:1\n"]
    assert failure_of(lines).startswith("error[E0308]")
    assert failure_of(["one\n", "two\n"]) == "one\ntwo"


def test_counts_are_added_over_binaries():
    lines = ["test result: ok. 10 passed; 0 failed\n", "test result: ok. 2 passed; 0 failed\n"]
    assert passed_count(lines) == 12
    assert passed_count(["running 0 tests\n"]) == 0
