"""Overrides by which views draw contacts and impacts: edges by their impulses, and recent impacts only."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.api import VisualizerLike
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping
from rerun.encodings import EntityPathLike

from carom.recording.schema import paths
from carom.recording.schema.clock import Clock
from carom.recording.schema.header import Header
from carom.recording.schema.paths import SIM_TIME

Overrides = dict[EntityPathLike, VisualizerLike]

_OF_LATE = 1 / 300  # of the duration, for which an impact stays visible


def force_arrows(header: Header) -> list[str]:
    """Return the entities of the arrows of impulses that a recording has."""
    if not header.records_contacts:
        return []
    return [paths.FORCE_NORMAL, *([paths.FORCE_FRICTION] if header.has_friction else [])]


def edges_by_impulse(header: Header) -> Overrides:
    """Draw the edges of the collision graph with the widths and colours of their impulses: force chains."""
    if not header.records_contacts:
        return {}
    sources = {"LineStrips3D:colors": "impulse_colour", "LineStrips3D:radii": "impulse_width"}
    mappings = [
        VisualizerComponentMapping(target, ComponentSourceKind.SourceComponent, source_component=source)
        for target, source in sources.items()
    ]
    return {paths.CONTACTS: rr.LineStrips3D.from_fields().visualizer(mappings=mappings)}


def recent_impacts(header: Header) -> Overrides:
    """Show impacts for a short time; by default each would stay visible until the next."""
    if not header.records_contacts:
        return {}
    clock = Clock.fitting(header.duration, header.shortest_dt_hint)
    start = rr.TimeRangeBoundary.cursor_relative(nanos=-int(1e9 * header.duration * _OF_LATE / clock.scale))
    end = rr.TimeRangeBoundary.cursor_relative()
    return {paths.IMPACTS: rrb.VisibleTimeRanges(timeline=SIM_TIME, start=start, end=end)}
