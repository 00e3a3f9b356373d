"""Shared fixtures: the real recordings beside the checkout, and a small simulated take."""

from pathlib import Path

import pytest

import markerloom as ml

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def data() -> Path:
    if not DATA.is_dir():
        pytest.skip("the real recordings (../shared/data) are not on this machine")
    return DATA


@pytest.fixture(scope="session")
def take() -> ml.SimulatedTake:
    return ml.simulate(ml.make_scene("exp61", frames=20, seed=4))


@pytest.fixture(scope="session")
def folder(take: ml.SimulatedTake, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The take as files."""
    path = tmp_path_factory.mktemp("take")
    ml.save(take, path)
    return path


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What programs keep for the user is kept for this test alone."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
