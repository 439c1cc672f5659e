"""The procedures that an operator may start: those of the commands, with the same files."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from yaml import YAMLError

from fringedic.calibration.acceptance_sentences import acceptance_text
from fringedic.calibration.sentences import check_sentence, check_warning_sentences
from fringedic.command.acceptance import accept
from fringedic.command.advice import advise_on_images
from fringedic.command.folders import unused_folder
from fringedic.command.run_results import sign_results, write_results
from fringedic.configuration.changes import change_rig_file, with_angles
from fringedic.configuration.forecast import forecast
from fringedic.configuration.programme import Programme
from fringedic.configuration.programme_check import check_programme, parse_programme
from fringedic.configuration.rig_file import RigFile, load_rig_file
from fringedic.configuration.test_card import Card, load_card
from fringedic.configuration.test_form import Answers, answered_specimen, specimen_field
from fringedic.configuration.yaml_section import Section, validate
from fringedic.errors import ConfigurationError, FringedicError, NodeDiedError, OperatorError, WaitTimeoutError
from fringedic.frames.files import write_grey
from fringedic.frames.region import Region
from fringedic.patterns.pattern import WHITE
from fringedic.rig_setup.live_sentences import live_entries
from fringedic.rig_setup.settings_sentences import noise_floor_text, settings_report
from fringedic.wording.path_names import path_name
from fringedic.wording.yaml_text import load_yaml
from fringedic_bringup.launch.graph import exposing_graph, rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.operating.options import RunOptions, TestOptions, options_of
from fringedic_bringup.operating.status import STOPPED, Job, Outcome, StoppedError
from fringedic_bringup.procedures.accept import shapes_by_nodes
from fringedic_bringup.procedures.calibrate import calibrate
from fringedic_bringup.procedures.check import check
from fringedic_bringup.procedures.exposing import ExposingClient
from fringedic_bringup.procedures.live import part_of_image, watch
from fringedic_bringup.procedures.noise import measure_noise
from fringedic_bringup.procedures.region import SETTLING_S
from fringedic_bringup.procedures.response import PICTURE as RESPONSE_PICTURE
from fringedic_bringup.procedures.response import measure_rig_response
from fringedic_bringup.procedures.run import load_rig, run_experiment
from fringedic_bringup.procedures.timing import measure_rig_timing
from fringedic_bringup.setup_patterns import LivePattern

IMAGES_AT_REST = 3


@dataclass(frozen=True)
class Request:
    """What an operator asks for; fields as of ``fringedic_msgs/StartProcedure``."""

    procedure: str
    pattern: str = ""
    text: str = ""
    options: Section = field(default_factory=Section)


@dataclass(frozen=True)
class Place:
    """The rig file, and the ROS domain; files are written beside the rig file."""

    rig_path: Path
    domain: int | None = None

    @property
    def rig(self) -> RigFile:
        """The present content of the rig file."""
        return load_rig_file(self.rig_path)

    def content(self) -> dict[str, Any]:
        """Return the keys of the rig file as they are written; none of a file that cannot be read."""
        try:
            return dict(load_yaml(self.rig_path.read_text("utf-8")))
        except (OSError, UnicodeDecodeError, YAMLError, TypeError, ValueError):
            return {}

    @property
    def folder(self) -> Path:
        """Folder of the rig file."""
        return self.rig_path.absolute().parent

    def new_folder(self, job: Job, name: str) -> Path:
        """Return a folder that does not exist yet, and show it."""
        folder = unused_folder(self.folder / name)
        job.writes_into(str(folder))
        return folder

    def own_file(self, name: str) -> Path:
        """Return a file of this rig alone, beside the rig file: the folder may contain rig files of other rigs."""
        return self.folder / f"{self.rig_path.stem}_{name}"

    def relative(self, file: Path) -> str:
        """Return a path as the rig file names it."""
        return os.path.relpath(file, self.folder)


def _live(place: Place, job: Job, request: Request, options: Any) -> Outcome:
    pattern, part = LivePattern(request.pattern or LivePattern.WHITE), part_of_image(options.region)
    with closing(watch(place.rig, place.rig_path, pattern, region=part, domain=place.domain)) as views:
        job.stage("live")
        for figures in views:
            entries = live_entries(figures, pattern.kind)
            focus = f"focus: {100 * figures.focus:.0f} % of the best"
            job.figures = (focus, *(f"{entry.name}: {entry.value}: {entry.advice}" for entry in entries))
            if job.is_stopping:
                break
    return Outcome()


def _timing(place: Place, job: Job, _: Request, options: Any) -> Outcome:
    folder = place.new_folder(job, "timing")
    report = measure_rig_timing(
        place.rig,
        place.rig_path,
        folder,
        job,
        exposure_time=1e-3 * options.exposure_ms,
        longest=1e-3 * options.longest_ms,
        domain=place.domain,
    )
    return Outcome(report.words, report.settings, "timing.png")


def _response(place: Place, job: Job, *_: object) -> Outcome:
    folder = place.new_folder(job, "response")
    report = measure_rig_response(place.rig, place.rig_path, folder, job, domain=place.domain)
    return Outcome(report.words, report.setting, RESPONSE_PICTURE)


def _calibrate(place: Place, job: Job, _: Request, options: Any) -> Outcome:
    rig = with_angles(place.rig, options.angles_deg) if options.angles_deg else place.rig
    folder = place.new_folder(job, "calibration")
    report = calibrate(rig, place.rig_path, folder, job, ask=job.ask, watch=job.raise_when_stopped, domain=place.domain)
    settings = f"calibration: {place.relative(report.file)}" if report.go else ""
    return Outcome(report.words, settings, good=report.go)


def _check(place: Place, job: Job, _: Request, options: Any) -> Outcome:
    folder, rig = place.new_folder(job, "check"), place.rig
    measured_with, words = _calibration_of(place)
    if options.vdi:
        tested = accept(
            rig,
            place.rig_path,
            folder,
            job,
            measure=lambda: shapes_by_nodes,
            ask=job.ask,
            domain=place.domain,
        )
        return Outcome([*acceptance_text(tested).splitlines(), words], good=tested.passed, measured_with=measured_with)
    result = check(
        rig,
        place.rig_path,
        folder,
        job,
        distance=1e-3 * options.distance_mm,
        ask=job.ask,
        watch=job.raise_when_stopped,
        domain=place.domain,
    )
    sentences = [check_sentence(result), *check_warning_sentences(result), words]
    return Outcome(sentences, good=result.holds, measured_with=measured_with)


def _calibration_of(place: Place) -> tuple[str, str]:
    """Return the line of the rig file that names the calibration in use, empty without one, and a sentence about it."""
    named = place.content().get("calibration")
    if not isinstance(named, str):
        return "", "The calibration that was checked is in the rig file itself."
    file = place.folder / named
    written = f", written {datetime.fromtimestamp(file.stat().st_mtime):%Y-%m-%d %H:%M}" if file.is_file() else ""
    return f"calibration: {named}", f"The calibration that was checked is {named}{written}."


def _region(place: Place, job: Job, request: Request, _: Section) -> Outcome:
    region = Region.from_text(request.text)
    share = 100 * region.share()
    if share == 0:
        raise ConfigurationError("the region is empty: draw a part of the image that is not a hole")
    picture = place.own_file("region.png")
    corners = region.save(picture)[1]
    job.writes_into(str(place.folder))
    line = f"region_file: {corners.name}"
    change_rig_file(place.rig_path, line)
    words = f"the region is {share:.0f} % of the image; the rig file uses it"
    return Outcome([words], picture=picture.name, measured_with=line)


def _noise(place: Place, job: Job, _: Request, options: Any) -> Outcome:
    folder = place.new_folder(job, "noise")
    measured = measure_noise(place.rig, place.rig_path, folder, job, steps=options.steps, domain=place.domain)
    setting = f"noise_floor_file: {place.relative(folder / 'noise_floor.yaml')}"
    return Outcome(noise_floor_text(measured.metadata).splitlines(), setting, "noise_floor.png")


def _advise(place: Place, job: Job, _: Request, options: Any) -> Outcome:
    """Take three images at rest, and recommend window and spacing."""
    folder = place.new_folder(job, "static")
    folder.mkdir(parents=True)
    graph = exposing_graph(place.rig)
    files = [folder / f"static_{number}.png" for number in range(1, IMAGES_AT_REST + 1)]
    job.stage("taking images")
    with (
        RunningGraph(graph, folder / "logs", domain=place.domain) as running,
        ExposingClient(graph.namespace, domain=place.domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        if "projector" in graph.names:
            client.show(WHITE)
            client.sleep(SETTLING_S)
        for number, file in enumerate(files, start=1):
            job.part(1, 1, "images at rest", number, len(files))
            write_grey(file, client.expose().image)
    advice = advise_on_images(
        (files[0], files[1], files[2]),
        wanted_noise=options.wanted_noise_px,
        wanted_period=options.wanted_period_px,
        pixel_size=None if options.pixel_size_mm is None else 1e-3 * options.pixel_size_mm,
        strain_window=options.strain_window_points,
    )
    setting = f"nodes: {{dic: {{window: {advice.window}, spacing: {advice.spacing}}}}}"
    return Outcome(settings_report(advice).splitlines(), setting)


def _settings(place: Place, _: Job, request: Request, __: Section) -> Outcome:
    before = change_rig_file(place.rig_path, request.text)
    return Outcome([f"the rig file is changed; the file before is {before.name}"])


def _run(place: Place, job: Job, request: Request, options: RunOptions) -> Outcome:
    """Run a programme, or go on with one that ended early, as with ``--continue``."""
    name = options.continue_run
    rig, programme, answers = _test(place, request)
    if name:
        folder = _folder_of(place, name)
        job.writes_into(str(folder))
    else:
        folder = _recording_folder(place, job, rig, answers, programme.experiment)
        Card(rig_file=place.rig_path.name, answers=answers, programme=programme).save(folder)
    job.controlled, job.holds_without_driver = True, programme.on_operator_lost == "hold"
    report = run_experiment(
        rig, place.rig_path, programme, folder, job, domain=place.domain, resume=bool(name), control=job
    )
    words = [f"{len(report.steps)} steps in {folder.name}"]
    words += [f"ended early: {report.ended_early}"] if report.ended_early else []
    words += [f"no dataset: {report.unmeasured}"] if report.unmeasured else []
    words += [
        f"{'a move' if step.step < 0 else f'step {step.step}'} failed: {step.error}"
        for step in report.steps
        if step.error
    ]
    return Outcome(words, good=not report.failed)


def _by_hand(place: Place, job: Job, _: Request, options: TestOptions) -> Outcome:
    """Start the nodes, and keep them until the operator stops; steps are measured by the action of the rig.

    When a node ends, the session ends with the results of what was recorded.
    """
    rig = _specimen_in(place.rig, options.test)
    folder = _recording_folder(place, job, rig, options.test, "by_hand")
    Card(rig_file=place.rig_path.name, answers=options.test).save(folder)
    graph = rig_graph(rig, place.rig_path, folder, experiment="by_hand")
    job.controlled = True
    problems: list[str] = []
    job.stage(f"starting {len(graph.nodes)} nodes")
    with (
        RunningGraph(graph, folder / "logs", domain=place.domain) as running,
        ExposingClient(graph.namespace, domain=place.domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        job.part(1, 1, "ready to measure")  # from here on there is a part: the page may ask for steps
        try:
            while not job.is_stopping:
                client.sleep(0.2)
            client.wait_until_recorded()
        except (NodeDiedError, WaitTimeoutError) as error:
            if "load_frame" in running.dead():
                problems.append(
                    "load_frame ended, so that no hold could be requested: stop the machine at its own controls"
                )
            problems.append(str(error))
    job.stage("writing dataset, pictures and report")
    try:
        report = write_results("by_hand", folder, [])
        unmeasured = report.unmeasured
        problems += filter(
            None, [sign_results(report, operator=rig.specimen.operator, calibration={rig.sensor: rig.calibration_file})]
        )
    except FringedicError as error:
        unmeasured = f"no dataset: {error}"
    words = [*problems, unmeasured or f"dataset and report in {folder.name}"]
    return Outcome(words, good=not problems and not unmeasured)


def check_request(place: Place, request: Request) -> None:
    """Refuse a test before anything is started for it.

    Raises
    ------
    FringedicError
        An answer of the form is wrong or missing; the programme is wrong, has moves that the machine cannot make, or
        does not fit on the disk.
    """
    if request.procedure == "by_hand" and isinstance(request.options, TestOptions):
        _specimen_in(place.rig, request.options.test)
    if request.procedure != "run":
        return
    rig, programme, _ = _test(place, request)
    check_programme(rig, programme)
    if isinstance(request.options, RunOptions) and not request.options.continue_run:
        forecast(rig, programme).check_disk(place.folder / rig.recording.folder)


def _test(place: Place, request: Request) -> tuple[RigFile, Programme, Answers]:
    """Return the rig with the specimen of a test, its programme, and the answers of its form.

    A test that goes on has those of its card, where it has one.
    """
    options = request.options
    name = options.continue_run if isinstance(options, RunOptions) else ""
    answers = dict(options.test) if isinstance(options, TestOptions) else {}
    card = load_card(_folder_of(place, name)) if name else None
    if card is not None and card.programme is not None:
        programme, answers = card.programme, dict(card.answers)
        rig = place.rig
        if programme.specimen is not None:
            rig = rig.model_copy(update={"specimen": programme.specimen})
    else:
        rig, programme = _programme(place, request.text)
    return _specimen_in(rig, answers), programme, answers


def _specimen_in(rig: RigFile, answers: Answers) -> RigFile:
    """Return a rig with the specimen that the form of a test describes."""
    return rig.model_copy(update={"specimen": answered_specimen(rig.test_form, rig.specimen, answers)})


def _folder_of(place: Place, name: str) -> Path:
    """Return the folder of an earlier run.

    Raises
    ------
    ConfigurationError
        The text is no name of a folder.
    """
    recordings = place.rig.recording.folder
    if name != path_name(name):
        raise ConfigurationError(f"continue_run: {name} is no name of a folder in {recordings}")
    return place.folder / recordings / name


def _programme(place: Place, text: str) -> tuple[RigFile, Programme]:
    """Return the rig, and the programme in a text or in the rig file."""
    if not text.strip():
        return load_rig(place.rig_path, None, None)
    programme = parse_programme(text)
    rig = place.rig
    if programme.specimen is not None:
        rig = rig.model_copy(update={"specimen": programme.specimen})
    return rig, programme


def _recording_folder(place: Place, job: Job, rig: RigFile, answers: Answers, experiment: str) -> Path:
    """Return the folder of a new test, named as its specimen where the form has one, else as its programme."""
    if specimen := str(answers.get(specimen_field(rig.test_form), "")):
        experiment = path_name(specimen)
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S")
    return place.new_folder(job, f"{rig.recording.folder}/{experiment}-{stamp}")


class Procedure(NamedTuple):
    """What a procedure does, and the names of its options among those of the command, or their own section."""

    carry_out: Callable[[Place, Job, Request, Any], Outcome]
    names: tuple[str, ...] = ()
    section: type[Section] | None = None

    def options(self, name: str) -> type[Section]:
        """Return the options of the procedure `name`; a plain `Section` has none."""
        return self.section or (options_of(name, self.names) if self.names else Section)


PROCEDURES = {
    "live": Procedure(_live, ("region",)),
    "timing": Procedure(_timing, ("exposure_ms", "longest_ms")),
    "response": Procedure(_response),
    "calibrate": Procedure(_calibrate, ("angles_deg",)),
    "check": Procedure(_check, ("distance_mm", "vdi")),
    "region": Procedure(_region),
    "noise": Procedure(_noise, ("steps",)),
    "advise": Procedure(_advise, ("wanted_noise_px", "wanted_period_px", "pixel_size_mm", "strain_window_points")),
    "settings": Procedure(_settings),
    "run": Procedure(_run, section=RunOptions),
    "by_hand": Procedure(_by_hand, section=TestOptions),
}


def requested(procedure: str, pattern: str = "", text: str = "", options: str = "") -> Request:
    """Return a checked request; arguments as of ``fringedic_msgs/StartProcedure``.

    Raises
    ------
    OperatorError
        There is no such procedure.
    ConfigurationError
        An option is unknown or out of its range.
    """
    if procedure not in PROCEDURES:
        raise OperatorError(f"{procedure}: there is no such procedure; use {', '.join(PROCEDURES)}")
    try:
        content = load_yaml(options) or {}
    except YAMLError as error:
        raise ConfigurationError(f"{procedure}: the options are not YAML: {error}") from error
    if not isinstance(content, dict):
        raise ConfigurationError(f"{procedure}: the options are no mapping; write them as {{exposure_ms: 3.0}}")
    return Request(procedure, pattern, text, validate(PROCEDURES[procedure].options(procedure), content, procedure))


def execute(place: Place, job: Job, request: Request) -> None:
    """Execute a procedure; its result or the reason of its failure is in the status of the job."""
    try:
        job.ended(PROCEDURES[request.procedure].carry_out(place, job, request, request.options))
    except StoppedError:
        job.ended(STOPPED)
    except Exception as error:
        # the thread must not end without a word, whatever it was
        job.failed(str(error) or type(error).__name__)
