"""One surveyed lap of a small track, and the track learned from it, for all tests of this folder."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from race_laps import CAR, Lap, S

from robotd_plugins.behaviours.ftg_race.body import body_of
from robotd_plugins.perception.race_track import RaceTrackConfig, learn
from robotd_plugins.perception.track_survey import Sees, TrackSurveyConfig, TrackSurveyor
from robotd_plugins.toolkit.race_track import RaceTrack, TrackSurvey

SCRIPTS = str(Path(__file__).resolve().parents[3] / "scripts")


@pytest.fixture(scope="session", autouse=True)
def benches() -> Iterator[None]:
    """As the benches themselves have it."""
    sys.path.insert(0, SCRIPTS)
    yield
    sys.path.remove(SCRIPTS)


@pytest.fixture(scope="session")
def ground(benches: None) -> Any:
    """A track of 51 m with two hairpins."""
    from benches.race_plant import Ground
    from benches.race_tracks import procedural

    return Ground(procedural(3))


def surveyed(lap: Lap, laps: float = 1.4, **config: Any) -> TrackSurvey | None:
    """What the perceptor says of a car that drives from the start line."""
    surveyor = TrackSurveyor(TrackSurveyConfig(**config), CAR)
    for at_s in lap.times(0.0, laps * lap.lap_s):
        seen = Sees(now_ns=round(at_s * S), scan=lap.scan(at_s), odometry=lap.odometry(at_s), applied=None, goal=None)
        found = surveyor.step(seen)
        if found is not None:
            return found
    return None


@pytest.fixture(scope="session")
def lap(ground: Any) -> Lap:
    """The car that was surveyed."""
    return Lap(ground)


@pytest.fixture(scope="session")
def survey(lap: Lap) -> TrackSurvey:
    """Its first lap."""
    found = surveyed(lap)
    assert found is not None
    return found


@pytest.fixture(scope="session")
def track(survey: TrackSurvey) -> RaceTrack:
    """What was learned from it."""
    return learn(survey, RaceTrackConfig(), body_of(CAR))
