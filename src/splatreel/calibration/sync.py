"""Synchronization of the videos of a folder by sound, by what they show, or by timecode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Progress, listed
from splatreel.calibration import sound_sync, visible_sync
from splatreel.calibration.clocks import Lag, Timecode, read_timecode, timecode_difference
from splatreel.calibration.sound_sync import Agreement, SoundTravel, describe_unknown_travel, sound_travel
from splatreel.calibration.visible_sync import VisibleAgreement
from splatreel.capture.base import Request
from splatreel.capture.readers.calibrated import is_calibrated
from splatreel.capture.readers.colmap import is_colmap, unread_videos, videos_but
from splatreel.capture.readers.easyvolcap import is_easyvolcap
from splatreel.capture.readers.neu3dv import POSES
from splatreel.capture.readers.transforms import is_transforms
from splatreel.capture.segmented_video import segment_files
from splatreel.capture.sidecar import Sidecar, SyncEvidence, read_sidecar, write_starts
from splatreel.capture.videos import LATE_END, Videos

DRIFTS = 0.5
"""Minimum change of the lag between two videos, in frames, that counts as a drift of a clock."""
IN_STEP = 0.5
"""Maximum distance, in frames, of videos that are in step."""
EXACT = 0.001
"""Seconds to which sound aligns videos, if the time that it takes is known."""
MOST_REASONS = 4
"""Maximum number of reasons, and of videos with one reason, that an error lists."""
SEARCHED = 3
"""Maximum number of aligned videos in which the parts of a video's sound are searched."""


@dataclass(frozen=True)
class Clock:
    """Clock of a video: it shows `rate` * T + `shift` at time T of the capture, and 0 at its first frame."""

    rate: float = 1.0
    shift: float = 0.0

    @property
    def began(self) -> float:
        """Time of the capture at which the video starts."""
        return -self.shift / self.rate

    def lagging(self, lag: Lag) -> Clock:
        """Return the clock of a video whose lag from this one is known."""
        slower = 1 - lag.drift
        return Clock(slower * self.rate, slower * self.shift - lag.start)


@dataclass(frozen=True)
class Synchronization:
    """Start times of videos.

    Attributes:
        starts: Time in each video at which all videos have started, in seconds.
        rates: Seconds that a video's clock shows in a second of the capture, for clocks of other speeds than most.
        evidence: Evidence of each start time but one.
        frame: Seconds of a frame.
        seconds: Duration for which all videos run.
        end_together: True if all videos are equally long.
        notes: Sentences about alignments that were tried and refused.
        in_step: True if videos are in step with `splatreel.json`, which was not changed.
    """

    starts: dict[str, float]
    rates: dict[str, float]
    evidence: dict[str, SyncEvidence]
    frame: float
    seconds: float
    end_together: bool
    notes: list[str]
    in_step: bool = False
    exact: bool = False
    """True if the time that sound takes to the cameras is corrected."""

    def out_of_step(self, known: Sidecar) -> float:
        """Return by how many seconds videos are out of step with a sidecar. Videos that it does not name start together."""
        names, apart = list(self.starts), []
        for time in (0.0, self.seconds):
            found = np.array([self.starts[name] + self.rates.get(name, 1.0) * time for name in names])
            was = np.array([known.starts.get(name, 0.0) + known.rates.get(name, 1.0) * time for name in names])
            apart.append(float(np.ptp(found - was)))
        return max(apart)


def synchronize(
    path: Path, progress: Progress, leave_out: Sequence[str] = (), dry_run: bool = False
) -> Synchronization:
    """Find the start times of a folder's videos, and record them in `splatreel.json`.

    Start times of a calibrated capture, or those of an earlier run, are not changed if videos are in step with them.

    Args:
        path: Folder of videos.
        progress: Progress display.
        leave_out: Names of videos that are not used.
        dry_run: True writes nothing.

    Raises:
        CaptureError: Neither the sound, the image nor the timecode of a video tells when it starts.
    """
    found = find_starts(path, progress, leave_out)
    known = read_sidecar(path)
    settled = bool(known.starts) or (_is_calibrated(path) and found.end_together)
    again = found.exact and bool(known.sync)  # an earlier run may not have known how long sound takes
    if settled and found.out_of_step(known) <= (EXACT if again else IN_STEP * found.frame):
        return replace(found, in_step=True)
    if not dry_run:
        write_starts(path, found.starts, found.evidence, found.rates)
    return found


def _is_calibrated(path: Path) -> bool:
    formats = (is_colmap, is_easyvolcap, is_transforms, is_calibrated)
    return (path / POSES).is_file() or any(fits(path) for fits in formats)


def find_starts(path: Path, progress: Progress, leave_out: Sequence[str] = ()) -> Synchronization:
    """Find the start times of a folder's videos.

    Videos are aligned by sound, exact to less than a millisecond. Videos whose sound fits none are aligned by motion and
    light, exact to about half a frame, or else by timecode. A clock that drifts by half a frame gets a rate.

    Args:
        path: Folder of videos.
        progress: Progress display.
        leave_out: Names of videos that are not used.

    Raises:
        CaptureError: Neither the sound, the image nor the timecode of a video tells when it starts.
    """
    files = videos_but(path, leave_out)
    if len(files) < 2:
        others = "".join(f" {sentence}." for sentence in unread_videos(path))
        raise CaptureError(f"{path}: {len(files)} videos; at least two are needed to synchronize.{others}")
    search = _Search(path, files, progress)
    search.run()
    heard = {name for b, found in search.evidence.items() if found.by == "sound" for name in (found.other, b)}
    travel = sound_travel(path, sorted(heard)) if heard else None
    clocks = search.clocks if travel is None else _without_travel(search, travel)
    if heard:
        search.notes.append(describe_unknown_travel(search.frame) if travel is None else travel.describe())
    usual = min((c.rate for c in clocks.values()), key=lambda rate: sum(abs(rate - c.rate) for c in clocks.values()))
    begin = max(clock.began for clock in clocks.values())
    starts = {name: round(clocks[name].rate * begin + clocks[name].shift, 6) + 0.0 for name in files}
    rates = {name: round(clocks[name].rate / usual, 8) for name in files}
    rates = {name: rate for name, rate in rates.items() if rate != 1}
    lengths = {name: (search.seconds(name) - start) / rates.get(name, 1.0) for name, start in starts.items()}
    ends = [search.seconds(name) for name in files]
    return Synchronization(
        starts,
        rates,
        search.evidence,
        search.frame,
        max(min(lengths.values()), 0.0),
        max(ends) - min(ends) <= LATE_END * search.frame,
        search.notes,
        exact=travel is not None,
    )


def _without_travel(search: _Search, travel: SoundTravel) -> dict[str, Clock]:
    """Return the clocks without the time that sound takes. A video that was aligned otherwise moves with the other video."""
    first = next(name for name in search.clocks if name not in search.evidence)
    late = {first: travel.seconds.get(first, 0.0)}
    for name, found in search.evidence.items():  # in the order of alignment
        by_sound = found.by == "sound"
        late[name] = late[found.other] + (travel.seconds[name] - travel.seconds[found.other] if by_sound else 0.0)
    return {name: replace(clock, shift=clock.shift - clock.rate * late[name]) for name, clock in search.clocks.items()}


class _Search:
    """Search for the clocks of all videos, from the clearest alignment on."""

    def __init__(self, path: Path, files: dict[str, Path], progress: Progress) -> None:
        self.path = path
        self.files = files
        self.progress = progress
        self.evidence: dict[str, SyncEvidence] = {}
        self.notes: list[str] = []
        self._searched: set[str] = set()  # videos whose sound was searched in parts
        self._searched_motion: set[str] = set()
        self._visible: dict[tuple[str, str], VisibleAgreement] = {}
        self._videos = Videos(path, files, Sidecar(transfer=read_sidecar(path).transfer), Request(frames=(0, 1)))
        self._videos.close()
        self.frame = 1 / self._videos.fps
        self.clocks = {next(iter(self._sounds or files)): Clock()}

    @property
    def _waiting(self) -> list[str]:
        return [name for name in self.files if name not in self.clocks]

    def run(self) -> None:
        """Find all clocks.

        Raises:
            CaptureError: Nothing tells when a video starts.
        """
        while self._waiting:
            if not (self._by_sound() or self._by_parts() or self._by_motion() or self._by_timecode()):
                raise self._lost()

    def _join(self, a: str, b: str, lag: Lag, evidence: SyncEvidence) -> bool:
        self.clocks[b] = self.clocks[a].lagging(lag)
        self.evidence[b] = evidence
        if sound := self._sound_score(b):
            self.notes += [] if evidence.by == "sound" else [f"{b} is aligned by {evidence.by}: {sound}"]
        return True

    def _by_sound(self) -> bool:
        """Align the video whose whole sound fits an aligned one most clearly."""
        pairs = [(a, b) for a, b in self._heard if a in self.clocks and b not in self.clocks]
        if not pairs:
            return False
        a, b = max(pairs, key=lambda pair: self._heard[pair].clear)
        found = self._heard[a, b]
        if found.clear < sound_sync.CLEAR:
            return False
        drifting = sound_sync.align_drifting(self._sounds[a], self._sounds[b], found.later, DRIFTS * self.frame)
        return self._join_by_sound(a, b, *(drifting or (Lag(found.later), found)))

    def _join_by_sound(self, a: str, b: str, lag: Lag, found: Agreement) -> bool:
        return self._join(a, b, lag, SyncEvidence(a, "sound", round(found.clear, 2), sound_sync.CLEAR))

    def _by_parts(self) -> bool:
        """Align a video by parts of its sound, for clocks that drift more than whole tracks can show."""
        for b in [name for name in self._waiting if name in self._sounds and name not in self._searched]:
            self._searched.add(b)
            known = [a for a in self.clocks if a in self._sounds]
            for a in sorted(known, key=lambda a: -self._heard[a, b].clear)[:SEARCHED]:
                found = sound_sync.search_parts(self._sounds[a], self._sounds[b])
                if found is not None:
                    return self._join_by_sound(a, b, *found)
        return False

    def _by_motion(self) -> bool:
        """Align the video whose motion and light fit an aligned one most clearly."""
        pairs = [(a, b) for a in self.clocks for b in self._waiting]
        for a, b in pairs:
            if (a, b) not in self._visible:
                self._visible[a, b] = visible_sync.compare_activity(self._seen[a], self._seen[b])
        pairs.sort(key=lambda pair: -self._visible[pair].alike)
        for a, b in [pair for pair in pairs if self._visible[pair].certain][:1]:
            found = self._visible[a, b]
            least = max(DRIFTS * self.frame, visible_sync.ON_LINE)
            drifting = visible_sync.align_drifting(self._seen[a], self._seen[b], found.later, least)
            return self._join_by_motion(a, b, *(drifting or (Lag(found.later), found)))
        for a, b in pairs:
            if b not in self._searched_motion:
                drifting = visible_sync.search_parts(self._seen[a], self._seen[b])
                if drifting is not None:
                    return self._join_by_motion(a, b, *drifting)
        self._searched_motion |= set(self._waiting)
        return False

    def _join_by_motion(self, a: str, b: str, lag: Lag, found: VisibleAgreement) -> bool:
        return self._join(a, b, lag, SyncEvidence(a, "motion and light", round(found.clear, 2), visible_sync.CLEAR))

    def _by_timecode(self) -> bool:
        """Align a video by its timecode.

        Timecodes count only where images tell nothing, because clocks of cameras that were not synchronized differ by
        seconds. Timecodes of videos that do not overlap are of such clocks.
        """
        for b in self._waiting:
            for a in self.clocks:
                one, other = self._timecodes.get(a), self._timecodes.get(b)
                if one is not None and other is not None and self._overlap(a, b):
                    if one.drops != other.drops:
                        self.notes.append(_describe_countings(a, one, b, other))
                    return self._join(a, b, Lag(timecode_difference(one, other)), SyncEvidence(a, "timecode"))
        return False

    def _overlap(self, a: str, b: str) -> bool:
        later = timecode_difference(self._timecodes[a], self._timecodes[b])
        return -self.seconds(b) < later < self.seconds(a)

    def seconds(self, name: str) -> float:
        """Return the time of a video's last frame."""
        times = self._videos[name].times
        return float(times[-1]) if len(times) else 0.0

    @cached_property
    def _sounds(self) -> dict[str, np.ndarray]:
        self.progress.stage("reading the sound of the videos", len(self.files))
        found = {}
        for count, (name, file) in enumerate(self.files.items(), 1):
            sound = sound_sync.listen(file)
            if sound is not None:
                found[name] = sound
            self.progress.update(count)
        return found

    @cached_property
    def _heard(self) -> dict[tuple[str, str], Agreement]:
        if len(self._sounds) < 2:
            return {}
        length = sound_sync.common_length(self._sounds)
        phases = {name: sound_sync.phases(sound, length) for name, sound in self._sounds.items()}
        pairs = list(combinations(self._sounds, 2))
        self.progress.stage("comparing their sound in pairs", len(pairs))
        found: dict[tuple[str, str], Agreement] = {}
        for count, (a, b) in enumerate(pairs, 1):
            found[a, b] = agreement = sound_sync.compare(phases[a], phases[b], length)
            found[b, a] = Agreement(-agreement.later, agreement.clear)
            self.progress.update(count)
        return found

    @cached_property
    def _seen(self) -> dict[str, np.ndarray]:
        self.progress.stage("watching the videos, since their sound does not tell when they start", len(self.files))
        found = {}
        for count, (name, file) in enumerate(self.files.items(), 1):
            found[name] = visible_sync.watch(_first_part(file))
            self.progress.update(count)
        return found

    @cached_property
    def _timecodes(self) -> dict[str, Timecode]:
        codes = {name: read_timecode(_first_part(file)) for name, file in self.files.items()}
        return {name: code for name, code in codes.items() if code is not None}

    def _sound_score(self, b: str) -> str:
        scores = {a: found.clear for (a, other), found in self._heard.items() if other == b}
        if not scores:
            return ""
        best = max(scores, key=lambda a: scores[a])
        return f"its sound fits {best} best, {scores[best]:.2f} times as well as at another time ({sound_sync.CLEAR:g} is needed)"

    def _scores(self, b: str) -> str:
        sound = self._sound_score(b) or ("no other video has sound" if b in self._sounds else "it has no sound")
        return f"{sound}; {self._sight_score(b)}; {self._timecode_score(b)}"

    def _sight_score(self, b: str) -> str:
        found = {
            a: agreement
            for (a, other), agreement in self._visible.items()
            if other == b and min(visible_sync.seconds(self._seen[name]) for name in (a, b)) >= visible_sync.OVERLAP
        }
        if not found:
            shown = max(visible_sync.seconds(self._seen[a]) for a in self.clocks)
            short = "it" if visible_sync.seconds(self._seen[b]) < visible_sync.OVERLAP else "each aligned video"
            length = min(shown, visible_sync.seconds(self._seen[b]))
            return f"{short} is too short to be compared by motion and light ({length:.1f} s; {visible_sync.OVERLAP:g} s are needed)"
        best = max(found, key=lambda a: found[a].alike)
        return (
            f"its motion and light fit {best} best, with a correlation of {found[best].alike:.2f} ({visible_sync.ALIKE:g} is needed), "
            f"{found[best].clear:.2f} times that at another time ({visible_sync.CLEAR:g} is needed){self._slow_motion(b)}"
        )

    def _slow_motion(self, b: str) -> str:
        """Return a phrase if the motion of a video fits another one at several times its speed."""
        for a in self.clocks:
            for factor in visible_sync.SLOW_MOTION:
                for slow, fast in ((b, a), (a, b)):
                    sped = visible_sync.sped_up(self._seen[slow], factor)
                    if visible_sync.compare_activity(self._seen[fast], sped).certain:
                        return (
                            f", but they fit if {slow} plays {factor} times as fast: it seems to be slow motion. Store it at its true "
                            f"speed (ffmpeg -itsscale {1 / factor:g} -i {self.files[slow].name} -c:v copy -an OUT.mp4)"
                        )
        return ""

    def _timecode_score(self, b: str) -> str:
        code = self._timecodes.get(b)
        known = next((a for a in self.clocks if a in self._timecodes), None)
        if code is None or known is None:
            return "it has no timecode" if code is None else "no other video has a timecode"
        apart = abs(timecode_difference(self._timecodes[known], code))
        return f"its timecode {code.text} is {apart:.0f} s from {self._timecodes[known].text} of {known}, longer than the videos"

    def _lost(self) -> CaptureError:
        names = ", ".join(self.files[name].name for name in self._waiting)
        reasons: dict[str, list[str]] = {}
        for name in self._waiting:
            reasons.setdefault(self._scores(name), []).append(name)
        texts = [f"{listed(group)}: {reason}" for reason, group in reasons.items()]
        rest = len(texts) - MOST_REASONS
        scores = ". ".join(texts[:MOST_REASONS]) + (f". {rest} more fit no better" if rest > 0 else "")
        example = ", ".join(f'"{name}": seconds' for name in self.files)
        return CaptureError(
            f"{self.path}: nothing tells when {names} start. {scores}. Find something in these videos that others "
            f"show too, such as a step, and write into splatreel.json when it happens in each: "
            f'{{"starts": {{{example}}}}}; or leave them out (--leave-out). Next time, clap once that all hear.'
        )


def _describe_countings(a: str, one: Timecode, b: str, other: Timecode) -> str:
    (dropping, dropped), (free, counted) = ((a, one), (b, other)) if one.drops else ((b, other), (a, one))
    return (
        f"{dropping} has a drop-frame timecode ({dropped.text}) and {free} one that counts every frame ({counted.text}). They are "
        f"compared as times of day. At 29.97 frames a second, {free} falls behind by 3.6 s in each hour since its clock was set: set "
        f"all cameras to one counting"
    )


def _first_part(file: Path) -> Path:
    """Return a video, or the first video of a folder of its parts."""
    return segment_files(file)[0] if file.is_dir() else file
