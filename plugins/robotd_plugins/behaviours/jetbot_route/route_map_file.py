"""Reads map files of shapes A to D into route maps, or says everything that is wrong with them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path as FilePath

from robotd.setup.problems import Path, dotted
from robotd_plugins.behaviours.jetbot_route.route_map import RouteMap
from robotd_plugins.behaviours.jetbot_route.route_map_check import check_draft
from robotd_plugins.behaviours.jetbot_route.route_map_json import read_json
from robotd_plugins.behaviours.jetbot_route.route_map_problems import ERRORS, MapProblem, RouteMapError
from robotd_plugins.behaviours.jetbot_route.route_map_shapes import read_shape

MAX_BYTES = 1_000_000


@dataclass(frozen=True, slots=True)
class MapReading:
    """What came of a file. `map`: None where there are errors. `shape`: A, B, C, D, or empty where it is none."""

    map: RouteMap | None
    shape: str
    problems: tuple[MapProblem, ...]

    @property
    def errors(self) -> tuple[MapProblem, ...]:
        """What makes the map unusable, in the order of the file."""
        return tuple(problem for problem in self.problems if problem.is_error)

    @property
    def warnings(self) -> tuple[MapProblem, ...]:
        """What deserves a look, in the order of the file."""
        return tuple(problem for problem in self.problems if not problem.is_error)


def load_route_map(path: str | FilePath) -> RouteMap:
    """The route map of a file. Raises RouteMapError listing every error."""
    reading = read_route_map_file(path)
    if reading.map is None:
        raise RouteMapError(reading.problems)
    return reading.map


def read_route_map_file(path: str | FilePath) -> MapReading:
    """A file with all that is wrong with it; nothing is raised."""
    file = str(path)
    try:
        with FilePath(path).open("rb") as opened:
            raw = opened.read(MAX_BYTES + 1)
    except OSError as error:
        return _refused("file_unreadable", file, f"cannot be read: {error.strerror or error}")
    return read_route_map(raw, file)


def read_route_map(text: str | bytes, file: str = "map.json") -> MapReading:
    """The content of a file with all that is wrong with it; `file` is its name in messages. Nothing is raised."""
    if len(text) > MAX_BYTES:
        return _refused("file_too_large", file, f"is larger than {MAX_BYTES:,} bytes; is this a map?")
    if isinstance(text, bytes):
        try:
            text = text.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            return _refused("file_not_utf8", file, f"byte {error.start} is not UTF-8 text; save the file as UTF-8")
    if not text.strip():
        return _refused("file_empty", file, "is empty")
    source = read_json(text)
    told = [(m.offset, m.code, m.path, m.message) for m in source.mistakes]

    def tell(code: str, path: Path, message: str) -> None:
        if path not in source.spoiled:
            told.append((source.keys[path] if code == "key_unknown" else source.offset(path), code, path, message))

    made: RouteMap | None = None
    draft = read_shape(source.data, tell) if source.complete else None
    if draft is not None:
        made = check_draft(draft, tell, sound=not any(code in ERRORS for _, code, _, _ in told))
    told.sort(key=lambda mistake: mistake[0])
    problems = tuple(
        MapProblem(code, file, *source.line_column(offset), dotted(path), message)
        for offset, code, path, message in told
    )
    return MapReading(made, draft.shape if draft is not None else "", tuple(dict.fromkeys(problems)))


def _refused(code: str, file: str, message: str) -> MapReading:
    return MapReading(None, "", (MapProblem(code, file, None, None, "", message),))
