"""Pictures of a team: highway-env's road and cars, the driver's attention and the HMI below.

A picture is made from a :class:`Snapshot`, so that teams of any world can be drawn, also one of
thousands. The road is the merge of the team's :class:`Scene`.

Pictures are drawn on surfaces in memory and leave the process as it was: highway-env's own
viewer would start SDL's display, rename its window and show nothing under SDL's dummy driver, so
only the parts of it that draw are used. A window starts the display, as every window must.
"""

from __future__ import annotations

import os
import weakref
from dataclasses import dataclass, replace

import numpy as np
import pygame
from highway_env.road.graphics import RoadGraphics, WorldSurface
from highway_env.vehicle.graphics import VehicleGraphics
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle
from numpy.typing import NDArray

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import known_name
from hmi_marl.envs.scene import LANE_WIDTH
from hmi_marl.envs.team_step import NO_ACTION
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import VEHICLE_ACTIONS, Snapshot
from hmi_marl.envs.worlds.highway import MergeScene

PANEL_HEIGHT = 74
PIXELS_PER_METRE = 5.5
BELIEF_ROWS = 4
GREEN, RED, AMBER, BLUE = (50, 170, 60), (205, 60, 60), (240, 170, 30), (90, 170, 230)
DARK, GREY, LIGHT, PANEL = (40, 44, 52), (150, 155, 165), (232, 234, 238), (250, 250, 252)
GHOST = (200, 60, 160, 45)
_Place = tuple[int, int]
_Colour = tuple[int, int, int]


@dataclass(frozen=True)
class TeamStatus:
    """Content of the panel under the road, about one team."""

    driver: str
    inflation: float
    distracted: bool
    alert: bool
    steps_left: int
    """Steps in which the accepted alert is in effect, counted from the step shown, so that it is
    ``window`` in the step of the alert itself; 0 when none is."""
    window: int
    intended: str
    applied: str
    speed: float
    time: float
    crashed: bool
    strength: float = 1.0
    """Strength of the alert, where there is one."""
    belief: tuple[tuple[str, float], ...] = ()
    """The HMI's belief about the driver: names and their probabilities."""
    reveals: bool = False
    """Whether a^H showed d in the last step, as it differed from the action applied before."""
    distracted_belief: float | None = None
    """Exact belief p(d = 1) from a^H, v and the alerts, where attention is hidden; None where it is
    seen or not known."""


def team_status(teaming: Teaming, team: int) -> TeamStatus:
    """The status of one of the teams, after its last step.

    Once the driver has acted for the next step, the intent shown still is the last step's, which
    belongs to the action that was applied.
    """
    traits, attention = teaming.traits, teaming.attention
    window = teaming.config.alert_window
    own = [float(column) for column in traits.as_array()[team]]
    intended = teaming.previous_intended if teaming.intent_given[team] else teaming.intended
    return TeamStatus(
        driver=known_name(*own) or "driver",
        inflation=own[3],
        distracted=bool(attention.distracted[team]),
        alert=bool(teaming.alerted[team]),
        steps_left=int((attention.accepted[team] > 0) * (window - attention.counter[team])),
        window=window,
        intended=_action_name(intended[team]),
        applied=_action_name(teaming.applied[team]),
        speed=float(teaming.ego.speed[team]),
        time=float(teaming.steps[team] / teaming.config.scene.policy_frequency),
        crashed=bool(teaming.ego.crashed[team]),
        strength=float(teaming.alerts.strength(max(1, teaming.alerted[team]))),
    )


def _action_name(action: int) -> str:
    return "-" if action == NO_ACTION else VEHICLE_ACTIONS[action]


def between(before: Snapshot, after: Snapshot, fraction: float) -> Snapshot:
    """A moment between two snapshots of the same episode, for smooth clips."""
    if len(before.position) != len(after.position):
        return after
    blend = {
        name: (1 - fraction) * getattr(before, name) + fraction * getattr(after, name)
        for name in ("time", "position", "heading", "speed")
    }
    return replace(before if fraction < 0.5 else after, **blend)


class Viewer:
    """Draws snapshots of teams that drive in the same scene.

    A window that was closed, by its button or by :meth:`close`, stays closed; what is drawn then
    is not shown. Pygame may be quit in between, as any highway-env environment does when it closes.
    Events that are not about closing are left to the program's other windows, if it has any.

    Args:
        config: of the teams.
        window: also show each picture in a window, in real time.
        perceived: draw the other objects' perceived sizes around them.
        width: of the picture [px].

    Raises:
        RuntimeError: ``window`` where there is no display.
    """

    def __init__(
        self, config: TeamConfig, window: bool = False, perceived: bool = False, width: int = 880
    ) -> None:
        if window and not has_display():
            raise RuntimeError(
                "there is no display to open a window on; record a clip instead "
                '(hmi-marl watch --out clip.gif, or render_mode="rgb_array")'
            )
        self._perceived = perceived
        self.closed = False
        self._stage = MergeScene(config.scene)
        road_height = int((config.scene.lanes * LANE_WIDTH + 16.0) * PIXELS_PER_METRE) // 2 * 2
        self._size = (width // 2 * 2, road_height + PANEL_HEIGHT)
        self._across = (config.scene.lanes + 1) * LANE_WIDTH / 2
        # Of a depth of their own: a window that others have opened may have another.
        size = (self._size[0], road_height)
        self._road = WorldSurface(size, 0, pygame.Surface(size, depth=32))
        self._road.scaling = PIXELS_PER_METRE
        self._road.centering_position = [0.35, 0.5]
        self._canvas = pygame.Surface(self._size, depth=32)
        self._clock = pygame.time.Clock()
        self._frequency = config.scene.policy_frequency
        self._window = self._open_window() if window else None
        if window:
            _windowed.add(self)

    def draw(self, snapshot: Snapshot, status: TeamStatus, frames: int = 1) -> NDArray[np.uint8]:
        """A picture of shape (height, width, 3), uint8.

        Args:
            snapshot: of the team's world.
            status: what to show below the road.
            frames: pictures made for each policy step, which paces a window.
        """
        self._place(snapshot, status)
        road = self._road
        self._draw_road(road, snapshot)
        if self._perceived and status.inflation > 1:
            self._draw_perceived(road, status.inflation)
        self._canvas.blit(road, (0, 0))
        self._draw_panel(status, top=road.get_height())
        if self._window is not None:
            self._show(self._window)
            self._clock.tick(self._frequency * frames)
        return np.moveaxis(pygame.surfarray.array3d(self._canvas), 0, 1)

    def close(self) -> None:
        """Close the window, if there is one; other viewers go on."""
        self.closed = True
        if self._window is not None:
            self._window.destroy()
            self._window = None

    def asked_to_close(self, event: pygame.Event) -> bool:
        """Whether this event is the window's close button, or the end of the program."""
        return event.type == pygame.QUIT or (
            event.type == pygame.WINDOWCLOSE and event.window is self._window
        )

    def _open_window(self) -> pygame.Window:
        pygame.display.init()
        return pygame.Window("hmi-marl", self._size)

    def _show(self, window: pygame.Window) -> None:
        try:
            surface = window.get_surface()
        except pygame.error:  # pygame was quit, and the window with it
            window = self._window = self._open_window()
            surface = window.get_surface()
        surface.blit(self._canvas, (0, 0))
        window.flip()
        alone = pygame.display.get_surface() is None
        for event in pygame.event.get(None if alone else (pygame.QUIT, pygame.WINDOWCLOSE)):
            for viewer in list(_windowed):
                if viewer.asked_to_close(event):
                    viewer.close()

    def _place(self, snapshot: Snapshot, status: TeamStatus) -> None:
        """Put stand-ins for the snapshot's vehicles on the stage's road."""
        road = self._stage.road
        road.vehicles = [
            _stand_in(*vehicle)
            for vehicle in zip(
                snapshot.position, snapshot.heading, snapshot.speed, snapshot.crashed, strict=True
            )
        ]
        driven = road.vehicles[0]
        if not driven.crashed:
            driven.color = AMBER if status.distracted else GREEN
        road.objects = [Obstacle(None, position) for position in snapshot.obstacles]

    def _draw_road(self, surface: WorldSurface, snapshot: Snapshot) -> None:
        """The road with what is on it, following the driven car along the road, not across it."""
        road = self._stage.road
        surface.move_display_window_to(np.array([snapshot.position[0, 0], self._across]))
        RoadGraphics.display(road, surface)
        RoadGraphics.display_road_objects(road, surface, offscreen=True)
        RoadGraphics.display_traffic(road, surface, offscreen=True)

    def _draw_perceived(self, road: WorldSurface, inflation: float) -> None:
        ghosts = pygame.Surface(road.get_size(), pygame.SRCALPHA)
        for other in self._stage.road.vehicles[1:] + self._stage.road.objects:
            cosine, sine = np.cos(other.heading), np.sin(other.heading)
            half = inflation / 2 * np.array([other.LENGTH, other.WIDTH])
            corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
            turned = corners @ np.array([[cosine, sine], [-sine, cosine]]) + other.position
            pixels = [road.vec2pix(corner) for corner in turned]
            pygame.draw.polygon(ghosts, GHOST, pixels)
            pygame.draw.polygon(ghosts, (*GHOST[:3], 160), pixels, width=1)
        road.blit(ghosts, (0, 0))

    def _draw_panel(self, status: TeamStatus, top: int) -> None:
        canvas, width = self._canvas, self._size[0]
        pygame.font.init()
        self._font, self._small = pygame.font.Font(None, 24), pygame.font.Font(None, 19)
        pygame.draw.rect(canvas, PANEL, (0, top, width, PANEL_HEIGHT))
        first, second = top + 10, top + 44
        self._text(status.driver, (12, first + 3))
        self._text(f"t = {status.time:4.1f} s   {status.speed:4.1f} m/s", (12, second), small=True)
        state = ("DISTRACTED", AMBER) if status.distracted else ("ATTENTIVE", GREEN)
        if status.crashed:
            state = ("CRASHED", RED)
        self._badge(*state, (190, first))
        alert = "ALERT" if status.strength == 1.0 else f"ALERT {status.strength:.2g}"
        self._badge(
            alert if status.alert else "no alert", RED if status.alert else None, (330, first)
        )
        self._text("alert in effect", (190, second), small=True)
        for cell in range(status.window):
            box = (300 + 16 * cell, second, 12, 13)
            pygame.draw.rect(canvas, BLUE if cell < status.steps_left else LIGHT, box)
        overridden = status.intended != status.applied
        self._text(f"intended  {status.intended}", (480, first + 3))
        self._text(
            f"applied    {status.applied}", (480, second - 3), colour=RED if overridden else DARK
        )
        taken = bool(status.belief) or status.distracted_belief is not None
        if self._perceived:
            place = (100, first + 6) if taken else (680, first + 3)
            words = "x" if taken else "others perceived x"
            self._text(f"{words} {status.inflation:g}", place, small=True)
        if status.belief:
            self._draw_belief(status.belief, top)
        elif status.distracted_belief is not None:
            words = "reveals d" if status.reveals else "silent"
            self._badge(words, BLUE if status.reveals else None, (690, first))
            self._text("HMI: p(d)", (690, second), small=True)
            self._bar(status.distracted_belief, (770, second), AMBER)

    def _draw_belief(self, belief: tuple[tuple[str, float], ...], top: int) -> None:
        """A bar for each name, the likeliest in colour: as many as the panel has room for."""
        rows = sorted(belief, key=lambda entry: -entry[1])[:BELIEF_ROWS]
        shown = [entry for entry in belief if entry in rows]  # where they were before
        likeliest = rows[0]
        for row, (name, probability) in enumerate(shown):
            y = top + 5 + row * (PANEL_HEIGHT - 8) // BELIEF_ROWS
            self._text(name, (700, y), small=True)
            self._bar(probability, (770, y), BLUE if (name, probability) == likeliest else GREY)

    def _bar(self, probability: float, at: _Place, colour: _Colour) -> None:
        """A bar that is full at probability 1, in a row of small text."""
        x, y = at
        pygame.draw.rect(self._canvas, LIGHT, (x, y + 1, 96, 11))
        pygame.draw.rect(self._canvas, colour, (x, y + 1, round(96 * probability), 11))

    def _text(self, text: str, at: _Place, colour: _Colour = DARK, small: bool = False) -> None:
        font = self._small if small else self._font
        self._canvas.blit(font.render(text, True, colour), at)

    def _badge(self, text: str, colour: _Colour | None, at: _Place) -> None:
        box = pygame.Rect(*at, 126, 26)
        pygame.draw.rect(self._canvas, colour or LIGHT, box, border_radius=6)
        words = self._font.render(text, True, GREY if colour is None else (255, 255, 255))
        self._canvas.blit(words, words.get_rect(center=box.center))


_windowed: weakref.WeakSet[Viewer] = weakref.WeakSet()
"""Viewers with a window. They share one queue of events: each drawing handles it for all."""


def _stand_in(
    position: NDArray[np.float64], heading: float, speed: float, crashed: bool
) -> Vehicle:
    vehicle = Vehicle(None, position, float(heading), float(speed))
    vehicle.crashed = bool(crashed)
    vehicle.color = VehicleGraphics.RED if crashed else VehicleGraphics.BLUE
    return vehicle


def has_display() -> bool:
    """Whether a window can be opened here."""
    if os.name == "nt" or os.uname().sysname == "Darwin":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
