"""Closed loops: the shipped cars in their simulator, the plant of the bench, and that both drive alike."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from robotd.engine.loops import virtual_loop
from robotd.engine.runtime import Runtime
from robotd.setup.load import load_config
from robotd.world.messages import Odometry, Steer
from robotd_devices.sim import FlatWorld
from robotd_devices.sim.race_car import SimRaceCar
from robotd_devices.sim.single_track import F1TENTH, GRAVITY_MPS2, TT02D, RaceCar, RaceTrack
from robotd_plugins.behaviours.ftg_race import FtgRace, Sees

CONFIGS = Path(__file__).resolve().parents[3] / "configs"


class Drove:
    """What a run of the whole program left behind."""

    def __init__(self) -> None:
        self.worlds: list[FlatWorld] = []
        self.steps: list[tuple[Sees, Any]] = []


def drive(monkeypatch: pytest.MonkeyPatch, config: str, seconds: float, *sets: str) -> Drove:
    drove = Drove()
    opened, stepped = FlatWorld.open, FtgRace.step

    async def open_and_keep(self: FlatWorld) -> None:
        await opened(self)
        drove.worlds.append(self)

    def step_and_keep(self: FtgRace, seen: Sees) -> Any:
        result = stepped(self, seen)
        drove.steps.append((seen, result))
        return result

    monkeypatch.setattr(FlatWorld, "open", open_and_keep)
    monkeypatch.setattr(FtgRace, "step", step_and_keep)
    runtime = Runtime(load_config(CONFIGS / config, sim=True, sets=sets).parts, virtual=True)

    def started(running: Runtime) -> None:
        loop: Any = asyncio.get_running_loop()
        loop.call_at_ns(round(seconds * 1e9), running.stop)

    with asyncio.Runner(loop_factory=lambda: virtual_loop(None)) as runner:
        runner.run(runtime.run(started))
    return drove


@pytest.mark.parametrize(("config", "least_m"), [("f1tenth.yaml", 50.0), ("tt02d.yaml", 30.0)])
def test_the_shipped_cars_drive_a_lap_without_contact(
    monkeypatch: pytest.MonkeyPatch, config: str, least_m: float
) -> None:
    drove = drive(monkeypatch, config, 20.0)
    (world,) = drove.worlds
    assert world.collisions == 0
    assert world.effort_m > least_m


def test_the_planner_is_chosen_on_the_command_line(monkeypatch: pytest.MonkeyPatch) -> None:
    drove = drive(monkeypatch, "tt02d.yaml", 2.0, "behaviours.ftg_race.planner=baseline")
    _, last = drove.steps[-1]
    assert isinstance(last, Steer)


def test_the_whole_program_and_the_bench_give_the_same_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    """The views of one lap in the runtime, stepped through the bench's driver: the same commands bit for bit."""
    from benches.race_drivers import Behaving

    drove = drive(monkeypatch, "f1tenth.yaml", 15.0)
    monkeypatch.undo()
    driver = Behaving(F1TENTH, v_max_mps=5.0, mu=0.8)
    for seen, result in drove.steps:
        if seen.odometry is not None:
            assert driver(seen.scan, seen.odometry, seen.now_ns) == result


@pytest.mark.parametrize(("car", "rate_hz", "limit_s"), [(F1TENTH, 40.0, 13.0), (TT02D, 10.0, 17.0)])
def test_a_lap_in_the_bench_plant_from_a_standstill(car: RaceCar, rate_hz: float, limit_s: float) -> None:
    from benches.race_drivers import Behaving
    from benches.race_plant import Conditions, Ground, Race
    from benches.race_tracks import procedural

    sweep = car is TT02D
    conditions = Conditions(rate_hz=rate_hz, sweep=sweep, range_max_m=12.0 if sweep else 30.0)
    run = Race(Ground(procedural(3)), car, conditions).drive(Behaving(car), 1, limit_s=40.0)
    assert (run.crashed, run.stuck) == ("", "")
    assert run.laps_s[0] < limit_s
    assert run.over_grip_share <= 0.001


def test_the_shipped_tracks_are_those_of_the_committed_seeds() -> None:
    from benches.race_tracks import SEEDS, curvature, map_text, procedural

    folder = CONFIGS.parent / "maps" / "tracks"
    assert sorted(file.name for file in folder.glob("*.yaml")) == [f"track_{seed:02d}.yaml" for seed in SEEDS]
    for seed in SEEDS[:3]:
        assert (folder / f"track_{seed:02d}.yaml").read_text(encoding="utf-8") == map_text(seed)
        track = procedural(seed)
        assert track.width_m.max() <= 2.2
        assert 1.0 / abs(curvature(track.middle_m)).max() < 1.5


# ------------------------------------------------------------------------------------------------ the car


def rolled(car: RaceCar, steer: Steer, seconds: float, mu: float | None = None, **how: Any) -> RaceTrack:
    track = RaceTrack(car, 0.005, mu, **how)
    track.command(steer)
    for _ in range(round(seconds / 0.005)):
        track.step()
    return track


@pytest.mark.parametrize("car", [F1TENTH, TT02D])
def test_slowly_it_rolls_where_the_wheels_point(car: RaceCar) -> None:
    import math

    track = rolled(car, Steer(0.8, 0.2), 3.0)
    assert track.vx_mps == pytest.approx(0.8, abs=0.02)
    assert track.wz_radps == pytest.approx(track.vx_mps * math.tan(0.2) / car.wheelbase_m, rel=0.01)


@pytest.mark.parametrize("mu", [0.5, 1.0])
def test_the_tyres_hold_no_more_than_friction(mu: float) -> None:
    track = rolled(F1TENTH, Steer(6.0, 0.3), 3.0, mu)
    assert track.vx_mps * abs(track.wz_radps) <= 1.03 * mu * GRAVITY_MPS2
    linear = rolled(F1TENTH, Steer(6.0, 0.3), 3.0, mu, saturates=False)
    assert linear.vx_mps * abs(linear.wz_radps) > 1.2 * mu * GRAVITY_MPS2


def test_it_brakes_within_friction_and_then_stands() -> None:
    track = rolled(F1TENTH, Steer(6.0), 3.0)
    before = track.vx_mps
    track.command(Steer(0.0))
    for _ in range(40):
        track.step()
    assert before - track.vx_mps <= 9.51 * 0.2 + 0.1
    for _ in range(400):
        track.step()
    assert track.vx_mps == 0.0


def test_left_and_right_are_alike() -> None:
    left, right = rolled(F1TENTH, Steer(5.0, 0.2), 1.0), rolled(F1TENTH, Steer(5.0, -0.2), 1.0)
    assert (left.vx_mps, left.wz_radps, left.vy_mps) == (right.vx_mps, -right.wz_radps, -right.vy_mps)


def test_the_twin_keeps_its_contract() -> None:
    assert SimRaceCar.emits == (Odometry,)
    assert SimRaceCar.sim_twin == "sim_race_car"
