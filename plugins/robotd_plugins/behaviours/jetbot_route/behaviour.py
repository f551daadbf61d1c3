"""The behaviour itself: with a map it drives the route, without one it follows the line."""

from __future__ import annotations

from typing import ClassVar

from robotd import Behaviour
from robotd.authoring.behaviour import StepResult
from robotd.authoring.device import DeviceMisconfigured
from robotd.authoring.explain import Explanation
from robotd.world.robot import Robot
from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig, JetBotRouteGoal
from robotd_plugins.behaviours.jetbot_route.line_follow import LineFollow
from robotd_plugins.behaviours.jetbot_route.mission import plan, planner
from robotd_plugins.behaviours.jetbot_route.route_drive import RouteDrive
from robotd_plugins.behaviours.jetbot_route.route_map_problems import RouteMapError
from robotd_plugins.behaviours.jetbot_route.sees import Sees
from robotd_plugins.behaviours.jetbot_route.states import State


class JetBotRoute(Behaviour[JetBotRouteConfig, Sees, JetBotRouteGoal]):
    """The seed's `JetBotController`. What it knows and decides is in its driver, one for each goal."""

    blind_after_s: ClassVar[float | None] = 2.0

    def __init__(
        self, config: JetBotRouteConfig, goal: JetBotRouteGoal | None = None, robot: Robot | None = None
    ) -> None:
        super().__init__(config, goal, robot)
        self.driver: RouteDrive | LineFollow = (
            LineFollow(config) if config.map is None else RouteDrive(config, plan(config, self.goal))
        )

    @classmethod
    def load(cls, config: JetBotRouteConfig) -> None:
        if config.map is not None:
            try:
                planner(config.map, config.pitch_m, config.costs)
            except RouteMapError as error:
                raise DeviceMisconfigured(f"behaviours.jetbot_route.map: {error}") from error

    @property
    def state(self) -> State:
        """The state of its driver."""
        return self.driver.state

    def step(self, seen: Sees) -> StepResult:
        return self.driver.step(seen)

    def explain(self) -> Explanation:
        return self.driver.explain()
