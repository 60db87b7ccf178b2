"""Fixtures that all tests share."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.pins import refusals

# What the caller has set for the product is not for its tests: they empty job tables. What is left
# says how to test.
OF_TESTS = (
    "NIGHTGLASS_CACHE",
    "NIGHTGLASS_PINS",
    "NIGHTGLASS_SATSIM_PYTHON",
    "NIGHTGLASS_SCREENSHOTS",
)
for name in {name for name in os.environ if name.startswith("NIGHTGLASS_")}.difference(OF_TESTS):
    del os.environ[name]

# The first call of a function compiles it: no deadline. The same examples in every run, so that a
# change is judged by its own tests; `make test-slow` looks for new ones.
settings.register_profile("steady", deadline=None, derandomize=True, max_examples=40)
settings.register_profile("search", deadline=None)
settings.load_profile("steady")
refusals.listen()


@pytest.fixture(autouse=True)
def words_of_refusals(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[None]:
    """What a test is refused is said in the words that are stored."""
    yield from refusals.hold(request.node, tmp_path_factory.getbasetemp())


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """First what compiles most, once; then the service's, which wait on processes; the quick last.

    A worker that a test kills would compile what it draws with again.
    """
    order = {"acceptance": 0, "rules": 0, "service": 1}
    here = Path(__file__).parent
    items.sort(key=lambda item: order.get(item.path.relative_to(here).parts[0], 2))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    call: pytest.CallInfo[None],
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Where a command failed that a test needs, the report shows what the command said."""
    report = yield
    error = call.excinfo.value if call.excinfo else None
    if isinstance(error, subprocess.CalledProcessError):
        for name, said in (("stdout", error.stdout), ("stderr", error.stderr)):
            text = said.decode(errors="replace") if isinstance(said, bytes) else said
            report.sections.append((f"{name} of the command", text or ""))
    return report


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data beside the repository; tests that need it skip where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("no real data beside the repository (shared/data)")
    return folder


@pytest.fixture(scope="session")
def published() -> Path:
    """The folder of published figures that come with the tests (tests/data/SOURCE.txt)."""
    return Path(__file__).resolve().parent / "data"
