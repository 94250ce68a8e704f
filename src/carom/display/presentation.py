"""`Presentation`: how a recording is shown at one moment: step, camera and layout."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from carom.arrays import FloatArray
from carom.contact_table import SLIDING
from carom.display.body_colours import body_colours, change_with_time, recorded_colours, redrawn_for, trail_colours
from carom.display.close_up import close_up
from carom.display.legend import LegendContents, drawn_at, drawn_during, impact_marks, legend
from carom.display.legend_layout import LegendLine, MovieClock
from carom.display.letters import drawable
from carom.display.margins import margins
from carom.display.moment_arrows import arrow_tips, drawn_arrows, numbers_apart
from carom.display.motion_marks import motion_marks
from carom.display.request import (
    Request,
    ShownStep,
    Watcher,
    at_impact,
    pair_of_step,
    shown_step,
)
from carom.display.staging import Staging, caption, decades, impact_strip, names_that_fit, whole_span
from carom.display.supplement import BodyPlots, Supplement, asked_quantities, body_series
from carom.errors import RecordingError, SceneError
from carom.recording.layout import (
    ALL,
    CLOSE_UP,
    PLOT,
    WINDOW,
    as_happened,
    blueprint,
    bodies_area,
    close_up_area,
    graph_name,
    hidden_arrows,
    is_crowded,
)
from carom.recording.layout.camera import FEW
from carom.recording.layout.canvas import Additions, CameraMotion, Canvas
from carom.recording.read.frame_rows import arrow_floors
from carom.recording.read.lookup import names_of, tolerance
from carom.recording.read.named_events import NamedEvent, Pair, named_event, named_pair, pair_of_extreme
from carom.recording.read.recorded_scene import header_of_recording, recorded_curves, recorded_scene
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.header import Header, TimeScale, viewer_time
from carom.recording.timelines import STEP
from carom.recording.write.encoder import BatchEncoder
from carom.recording.write.rows import NO_STEPS, Index, Rows, state_rows
from carom.recording.write.static_entities import arrow_styles
from carom.scene.forces import UNIFORM_FIELD
from carom.scene.units.dimension import TIME
from carom.scene.wording import counted

_PLOTS = ("energy", PLOT)  # names of views that are plots
# entities that are not sent for repeated steps
_ONCE = (paths.EVENTS, paths.FINGERPRINT, paths.MOMENTUM, paths.IMPACTS)


@dataclass(frozen=True, slots=True)
class Presentation:
    """A moment of a recording, and the data that the viewer needs to show it."""

    time: float  # s, time at which the viewer pauses
    missing: str  # why the viewer shows the previous frame; empty if it shows the step
    supplement: Supplement


def asked(
    recording: Recording,
    request: Request,
    canvas: Canvas = WINDOW,
    only: str = ALL,
    *,
    dense: bool = False,
    clock: MovieClock | None = None,
    watch: Watcher = lambda _: None,
) -> Presentation:
    """Choose how a request is shown; raises RecordingError if there is no such moment, event or body."""
    if request.event is None:
        shown = NamedEvent(recording.moment(request.at), is_impact=request.at is None or only == CLOSE_UP)
    else:
        shown = named_event(recording, request.event)
    pair, plots = shown.pair if request.bodies is None else named_pair(recording, request.bodies), None
    if request.plot is not None:
        quantities = asked_quantities(recording, request.plot, one_unit=only == PLOT)
        plots = BodyPlots(body_series(recording, quantities, watch), recording.units, alone=only == PLOT)
    elif only == PLOT:
        raise RecordingError("a view of plots shows the curves named by plot, such as 0.speed; none is named")
    return presentation(
        recording,
        shown.time,
        canvas,
        only,
        within=shown.step,
        at_own_time=shown.is_impact,
        pair=pair,
        plots=plots,
        colour_by=request.colour_by,
        by_stage=request.edges == "stage",
        both_arrows=request.arrows == "both",
        dense=dense,
        movie_clock=clock,
        watch=watch,
    )


def presentation(
    recording: Recording,
    moment: float,
    canvas: Canvas = WINDOW,
    only: str = ALL,
    *,
    within: int | None = None,
    at_own_time: bool = False,
    pair: Pair | None = None,
    plots: BodyPlots | None = None,
    colour_by: str | None = None,
    by_stage: bool = False,
    both_arrows: bool = False,
    dense: bool = False,
    movie_clock: MovieClock | None = None,
    watch: Watcher = lambda _: None,
) -> Presentation:
    """Choose how a moment (s) is shown.

    Parameters
    ----------
    only
        A single view, or all views.
    within
        The step that the moment belongs to, if it is the end of one step and the beginning of the next.
    at_own_time
        Whether to pause within the step, when the pair meets, rather than at its end; by default only if the pair meets
        at the moment.
    pair
        The bodies of the close-up view; by default the bodies of the step's hardest impact, or else of the run's
        hardest impact, unless they wait to enter.
    colour_by
        The property that sets the colours, one of `COLOUR_BY` in recording/schema/header.py; by default as recorded.
    by_stage
        Whether the edges beside the bodies have the colours of the solver's stages, not of impulses.
    both_arrows
        Whether angular accelerations and changes of spin have arrows, too.
    dense
        Whether to add all steps up to the next recorded frame.
    movie_clock
        The text of the clock, if the moment is shown in the close-up of a movie.
    watch
        Called while steps are repeated.

    Raises
    ------
    RecordingError
        If there is no frame, or nothing to show in the view.
    """
    header = header_of_recording(recording)
    step = shown_step(recording, moment, within, dense=dense, watch=watch)
    motion = CameraMotion.STILL if canvas.rendered else None
    by = colour_by or header.coloured_by
    recoloured = by != header.coloured_by or redrawn_for(header, canvas.theme)
    chosen = pair or _pair(recording, header, step)
    places = [recording.shown.index(body) for body in chosen.bodies] if chosen else []
    if change_with_time(header, by) and not recoloured:  # in this branch, only the close-up view needs the colours
        fixed, own = None, recorded_colours(recording, header, places).on(canvas.theme)
    else:
        colours = body_colours(recording, header, by, step).on(canvas.theme)
        fixed, own = colours.fixed, colours.of(places)
    trails = trail_colours(recording, header, by, canvas.theme)
    staging = Staging.of(recording, header, step.position, trails, moment, motion, step)
    clock = TimeScale(float(recording.info["time_scale"]))
    instant = None if chosen is None else at_impact(step, chosen, header, recording.origin, moment, clock)
    within_step = instant is not None and (at_own_time or abs(instant.time - moment) <= tolerance(moment))
    paused = instant if instant is not None and within_step else step
    written = ""
    if canvas.rendered:
        written = f"t = {header.units.text(paused.time, TIME, '.9g')}"
        if paused.time < step.time:  # events and plots have the time of the step's end
            written += f", in the step to {header.units.text(step.time, TIME, '.6g')}"
        written += _what_happens(recording, step, paused, chosen)
    close = None
    if chosen is not None:
        close_area = close_up_area(header, canvas, only)
        close = close_up(
            *(recording, header, step, chosen, close_area, own, instant),
            pauses_within=within_step,
            clock=movie_clock or written,
            explained=only == CLOSE_UP and canvas.rendered,
            brief=canvas.rendered,
        )
    references = {name: float(value) for name, value in recording.arrow_references.items()}
    repeated, references = _steps(recording, header, step, references)
    rows = [*repeated, *(close.rows() if close else [])]
    if paused is not step:
        drawn, references = _instant(recording, header, paused, references)
        rows += drawn
    statics = list(close.statics()) if close else []
    rows += staging.rows()
    statics += staging.statics(canvas.theme)
    if plots is not None:
        if fixed is not None:
            plots = replace(plots, colours=dict(zip(recording.shown, fixed.tolist(), strict=True)))
        rows += plots.rows()
        statics += plots.statics()
    if recoloured:
        rows.append(colours.rows(header))
    # the repeated steps are added, so that peaks between frames fit into the plots
    curves = recorded_curves(recording)
    for series in repeated:
        if series.path in curves:
            column, *_ = series.columns
            curves[series.path].insert(series.index.times, column.as_arrow_array().flatten().to_numpy())
    laid_out = as_happened(header, curves)
    has_trails = staging.trails is not None
    marks = impact_marks(recording, header, paused.time)
    contents = LegendContents() if canvas.rendered else drawn_during(recording, laid_out)
    if paused.frame is not None:  # a repeated step may have arrows that no frame has
        contents |= drawn_at(paused.frame, laid_out)
    elif canvas.rendered:
        contents = drawn_during(recording, laid_out)
    contents |= LegendContents(impacts=len(marks) > 0, trails=has_trails)
    span = whole_span(recording)
    in_groups = canvas.rendered and only == ALL
    field, fastest = uniform_field(recording, header), 0.0 if close is None or in_groups else close.pair.spin_of_scale
    area = bodies_area(laid_out, canvas, only, close is not None)
    plain = staging.camera.view(area.aspect, narrow=area.rendered)
    named = names_that_fit(header, step.position, plain, area)
    words = legend(
        *(laid_out, by, fixed, references, paused.frame, contents),
        named=bool(named) and all(named),
        viewer_time=viewer_time(header.units, clock),
        fastest=fastest,
        field=field,
        by_stage=by_stage,
        both_arrows=both_arrows,
        instant=paused is not step,
        recent=staging.recent,
        grid=staging.grid,
        theme=canvas.theme,
    )
    touching = _few_touching(recording, header, paused)
    if in_groups:
        more = {} if close is None else {f"Close-up: {close.names}": close.pair.lines()}
        name = graph_name(header)
        words = words.grouped(f"{name}, only bodies that touch" if touching else name, more)
        words = replace(words, entries=[*words.entries, *_strip_lines(recording, paused.time)])
    elif close is not None:
        words = replace(words, entries=[*words.entries, *close.pair.speed_lines()])
    words = words.titled(header.title, written) if canvas.rendered else words
    added = Additions(
        *(close, has_trails, recoloured, by_stage, both_arrows, plots, words),
        recent=staging.recent_of(clock),
        moment=True,
        marks=marks,
    )
    arrows = drawn_arrows(header, recording.origin, paused, references, hidden_arrows(header, added))
    added = replace(added, tips=arrow_tips(arrows), touching=touching)
    if canvas.rendered and only in _PLOTS:
        title = [*([header.title] if drawable(header.title) else []), written]
        for row, static in caption(title, canvas.theme, span[0]):
            rows, statics = [*rows, row], [*statics, static]
        drawn_plots = None if plots is None else replace(plots, caption=title, span=clock.nanoseconds(span))
        added = replace(added, caption=title, plots=drawn_plots)
    past = np.zeros((0, 3)) if staging.trails is None else staging.trails.until(moment)
    visible, radius = np.concatenate([paused.position, past]), np.pad(header.radius, (0, len(past)))
    placed = margins(laid_out, staging.camera, canvas, only, added, words, field, visible, radius)
    rows += numbers_apart(laid_out, staging.camera, canvas, only, placed, arrows)
    statics += placed.statics
    statics += motion_marks(header, recording.origin, placed.view, placed.area, paused.time)
    statics += arrow_styles(header, canvas.theme)
    impulses, strip, bands = impact_strip(recording)
    curves |= impulses
    logarithms, drawn_logarithms, styles = decades(recording, header, curves)
    rows += [*strip, *drawn_logarithms]
    statics += [*bands, *styles]
    added = replace(
        placed.added,
        named=names_that_fit(header, step.position, placed.view, placed.area),
        viewer_time=viewer_time(header.units, clock),
        struck=bool(strip),
        decades=logarithms,
        span=clock.nanoseconds(span) if canvas.rendered else None,
    )
    layout = blueprint(header, staging.camera, curves, canvas, only, added)
    if close is not None:
        rows += close.camera_rows(layout)
    return Presentation(paused.time, step.missing, Supplement(layout, clock, rows, statics))


def _what_happens(recording: Recording, step: ShownStep, paused: ShownStep, pair: Pair | None) -> str:
    """Say what happens at the moment: which bodies meet, how many touch, or that the run ends."""
    hardest = pair_of_extreme(recording, "impact") == pair
    hardest = hardest and recording.closing.get("moments.impact.step") == step.step
    if pair is not None and (paused is not step or hardest):
        names = names_of(recording)
        ends = [recording.bodies.name[body] or names.of(body) for body in pair.bodies]
        ends += [] if pair.plane is None else [names.of(len(names.bodies) + pair.plane)]
        met = " meets ".join(ends) if len(ends) == 2 else f"impact of {ends[0]}"
        return f": {met}{' with the most energy of the run' if hardest else ''}"
    if paused.frame is None:
        return ""
    touching, rows = len(paused.frame.contacts.pairs), paused.frame.contact_rows
    slides = 0 if rows is None else int(np.count_nonzero(rows["mode"] == SLIDING))
    happens = f": {counted(touching, 'contact')}" if touching else ": nothing touches"
    happens += f", {'it slides' if touching == 1 else f'{slides} of them slide'}" if slides else ""
    if recording.closing.get("moments.contacts.step") == step.step:
        return f"{happens}, the most of the run"
    if step.step == int(recording.fingerprints()[STEP].to_numpy()[-1]):
        return f"{happens}; the end of the run"
    return happens


_PHASES = {
    "free": "free flight, apart from impacts",
    "colliding": "bodies touch or have just met",
    "settled": "most bodies rest on each other",
}
_LIMITS = {  # explanations of the limits of a step whose names say too little
    "cap": "the longest step that the scene allows",
    "fixed": "the step of the scene",
    "impact": "the next impact ends the step",
    "velocity": "the fastest body",
    "acceleration": "the largest acceleration",
    "friction": "a ball that slides will soon roll",
}


def _strip_lines(recording: Recording, moment: float) -> Iterator[LegendLine]:
    """Explain the colours of phases and limits at a moment (s), in lines that may be left out."""
    row = max(0, int(np.searchsorted(recording.fingerprints()["time"].to_numpy(), moment, side="right")) - 1)
    for path, colours, words in (
        (paths.PHASE, palette.PHASES, _PHASES),
        (paths.DT_LIMIT, palette.DT_LIMITS, _LIMITS),
    ):
        state = recording.states_at(int(recording.fingerprints()[STEP][row].as_py())).get(path)
        if state in words:
            what = "phase" if path == paths.PHASE else "limit of the step"
            yield LegendLine(f"■ {what} “{state}”: {words[state]}", colours[state], is_extra=True)


def uniform_field(recording: Recording, header: Header) -> FloatArray | None:
    """Return the uniform field (3,) m/s² of a recording; None if there is no field, or the scene cannot be read."""
    if UNIFORM_FIELD.name not in header.forces or not recording.scene_toml:
        return None
    try:
        return np.array(recorded_scene(recording).gravity.uniform, dtype=np.float64)
    except (RecordingError, SceneError):
        return None


def _pair(recording: Recording, header: Header, step: ShownStep) -> Pair | None:
    """Choose the pair of the close-up view; None if a body of the pair waits to enter, or has left."""
    chosen = pair_of_extreme(recording, "impact")
    if step.frame is not None and recording.closing.get("moments.impact.step") != step.step:
        chosen = pair_of_step(step.frame, header.bodies) or chosen
    if chosen is None or not np.isfinite(step.position[[recording.shown.index(body) for body in chosen.bodies]]).all():
        return None
    return chosen


_References = dict[str, float]


def _steps(
    recording: Recording, header: Header, step: ShownStep, references: _References
) -> tuple[list[Rows], _References]:
    """Return the rows of the repeated steps, and the magnitudes of arrows; no rows if all steps are recorded.

    If these steps are the first with arrows, they determine the magnitudes.
    """
    recorded = recording.fingerprints()[STEP].to_numpy()
    if all(np.any(recorded == frame.step) for frame in step.added):
        return [], references
    before = None if step.before is None else step.before.checkpoint
    floors = arrow_floors(recording, int(recorded[recorded < step.added[0].step].max(initial=0)))
    encoder = BatchEncoder(header, recording.origin, references, before=before, floors_before=floors, everything=True)
    found = [rows for rows in encoder.rows(step.added) if rows.path not in _ONCE and len(rows.steps)]
    return [*found, *_states_after(recording, step.added[-1].step)], dict(encoder.arrow_references)


def _instant(
    recording: Recording, header: Header, instant: ShownStep, references: _References
) -> tuple[list[Rows], _References]:
    """Return the bodies, contacts, arrows and energies of an instant within a step, with times but no steps.

    Return also the magnitudes of arrows, which the instant may determine.
    """
    assert instant.frame is not None and instant.state is not None
    encoder = BatchEncoder(header, recording.origin, references, everything=True)
    found = [
        replace(rows, index=rows.index._replace(impacts=NO_STEPS))
        for rows in encoder.at_impacts([instant.state])
        if rows.path != paths.IMPACT_SPINS
    ]
    return found, dict(encoder.arrow_references)


def _few_touching(recording: Recording, header: Header, shown: ShownStep) -> Sequence[int]:
    """Return the bodies of a crowd that touch something at a step, or an instant, if they are few; otherwise none."""
    if shown.frame is None or not is_crowded(header) or len(recording.shown) != header.bodies:
        return ()
    ends = np.unique(shown.frame.contacts.pairs)
    found: list[int] = ends[ends < header.bodies].tolist()
    return found if len(found) <= FEW else ()


def _states_after(recording: Recording, step: int) -> Iterator[Rows]:
    """Yield the recorded states at the first frame after a step, since only changes of states are recorded."""
    table = recording.fingerprints()
    later = np.flatnonzero(table[STEP].to_numpy() > step)
    if len(later):
        row = int(later[0])
        frame = Index(table[STEP].to_numpy()[row : row + 1], table["time"].to_numpy()[row : row + 1])
        for path, state in recording.states_at(int(frame.steps[0])).items():
            yield state_rows(path, frame, [state])
