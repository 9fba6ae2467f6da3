"""Writer of a reel, group by group. At any moment the files on disk are a valid reel."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np

from splatreel.base.atomic import remove, write_bytes
from splatreel.base.errors import ReelError
from splatreel.base.untrusted import open_regular
from splatreel.codec.encoder import EncodedLayer, ReelEncoder
from splatreel.codec.group_file import decode_group, decode_layer
from splatreel.codec.header import ReelHeader
from splatreel.codec.manifest import (
    MANIFEST,
    MAX_BYTES,
    MAX_PAGE_GROUPS,
    PAGE,
    FileEntry,
    Manifest,
    birth_order,
    make_page,
    parse_manifest,
)
from splatreel.codec.presentation import EMPTY, Asset, Presentation
from splatreel.config import EncodeConfig
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.storage.address import Address

_NUMBERED = re.compile(r"(?:layers|groups|pages)/(\d+)(?:\.[A-Za-z0-9_-]+)?\.(?:safetensors|json)")


def read_written_manifest(folder: Path) -> Manifest | None:
    """Return the manifest in a folder up to its first damaged page, or None without a manifest.

    Raises:
        ReelError: The manifest is invalid or cannot be read.
    """
    file = folder / MANIFEST
    try:
        with open_regular(file, ReelError) as opened:
            data = opened.read(MAX_BYTES + 1)
        return parse_manifest(data, str(file), Address(folder, ReelError).fetch, whole=False)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ReelError(f"{file}: cannot be read ({error.strerror}). Make it readable or delete it.") from error


def _first_damaged_group(folder: Path, manifest: Manifest) -> int:
    """Return the number of the first group with a damaged file or layer, or of the next group if all are intact.

    Raises:
        ReelError: A file cannot be read.
    """
    broken = [entry.group for entry in manifest.files if not _is_intact(folder, entry)]
    return max(min(broken, default=manifest.end_group), manifest.first_group)


def _is_intact(folder: Path, entry: FileEntry | Asset) -> bool:
    """Return whether a file has the length and digest of its entry. Raise `ReelError` if it cannot be read."""
    path, digest = folder / entry.uri, hashlib.sha256()
    try:
        if path.stat().st_size != entry.bytes:
            return False
        with open_regular(path, ReelError) as file:
            while part := file.read(1 << 20):
                digest.update(part)
    except FileNotFoundError:
        return False
    except OSError as error:
        raise ReelError(f"{path}: cannot be read ({error.strerror}). Make it readable or delete it.") from error
    return digest.hexdigest() == entry.sha256


def _find_leftover_files(folder: Path, manifest: Manifest, cut: bool) -> list[str]:
    """Return files of dropped groups, and pages, that a killed writer did not delete.

    `cut`: Include files after the last group.
    """
    found, named = [], manifest.uris
    for path in (path for kind in ("layers", "groups", "pages") for path in (folder / kind).glob("*")):
        uri = path.relative_to(folder).as_posix()
        name = _NUMBERED.fullmatch(uri)
        if not name or uri in named:
            continue
        number = int(name[1])
        if uri.startswith("pages/") or number < manifest.first_group or (cut and number >= manifest.end_group):
            found.append(uri)
    return sorted(found)


class ReelWriter:
    """Encoder of layers and groups into a directory, with a manifest that is updated after each group (docs/format.md).

    For every group, in order, call `add_layer` for the static points born at it, if any, then `add_group`. With
    `resume`, intact groups are kept. Continue with any number up to the next group; that group and all later ones are
    dropped. Without `resume`, an existing reel and its presentation are dropped.

    Args:
        path: Directory of the reel.
        header: Properties of the reel.
        config: Encoding settings. With renditions, every group is written in each; decoded results are of the best.
        resume: Keep the groups of an existing reel.
        first_group: Number of the first group if none is kept; None means 0, or that of the resumed reel. Layers born
            earlier come before it.
        page: Groups per page of the manifest. The manifest itself lists up to twice as many.

    Raises:
        ReelError: Files cannot be read, or no reader would accept the header. Nothing is encoded then.
        StorageError: Files cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        header: ReelHeader,
        *,
        config: EncodeConfig,
        resume: bool = False,
        first_group: int | None = None,
        page: int = PAGE,
    ) -> None:
        self.path = Path(path)
        self.encoder = ReelEncoder(config, header.cameras)
        self.config = self.encoder.config
        if not 1 <= page <= MAX_PAGE_GROUPS:
            raise ReelError(f"{self.path}: pages of {page} groups are not read, choose 1 to {MAX_PAGE_GROUPS}.")
        self._page = page
        self._pending: list[FileEntry] = []
        self._manifest = Manifest(
            **vars(header),
            generator=f"splatreel {metadata.version('splatreel')}",
            live=True,
            frames=0,
            first_group=first_group or 0,
            renditions=config.renditions if self.encoder.others else (),
        )
        self._check_header()
        if written := read_written_manifest(self.path):
            keep = resume and written.renditions == self._manifest.renditions
            self._take_over(written, keep, first_group)

    def _take_over(self, written: Manifest, keep: bool, first_group: int | None) -> None:
        """Start from an earlier reel: with its intact part if `keep`, otherwise with nothing of it."""
        manifest = self._manifest.with_files(written.layers, written.groups)
        self._manifest = replace(manifest, first_group=written.first_group, pages=written.pages)
        if cut := written.paged == len(written.groups):  # a damaged page, and everything after it, is missing
            self._write_manifest(self._manifest)
        if keep:
            for uri in _find_leftover_files(self.path, self._manifest, cut):
                self._delete(uri)
        self._drop_from(_first_damaged_group(self.path, self._manifest) if keep else written.first_group)
        if not self._manifest.groups:
            first = first_group if first_group is not None or not keep else written.first_group
            self._manifest = replace(self._manifest, first_group=first or 0)
        self._manifest = replace(self._manifest, presentation=self._without_damaged_assets(written.presentation))
        if not keep:
            self.present(EMPTY)

    @property
    def manifest(self) -> Manifest:
        """Manifest of the reel written so far."""
        return self._manifest

    def add_layer(
        self,
        group: int,
        first_frame: int,
        gaussians: Gaussians,
        importance: np.ndarray | None = None,
        encoded: EncodedLayer | None = None,
        until: int | None = None,
    ) -> tuple[Gaussians, np.ndarray]:
        """Encode static points born at a group. They appear in the manifest together with that group.

        A large layer is written in parts, each a layer of its own (`encoder.split_layer`). A group may have several layers, the
        longest-lived first. Before the first group of a reel that starts later,
        layers may be of any earlier group. Train on the returned points: later groups then compensate for the coding
        error.

        Args:
            group: Number of the group.
            first_frame: First frame of the group.
            gaussians: Static points.
            importance: Effect of each point's shape, color and position on the images, [N, 3]; None weighs all points
                equally.
            encoded: Result of `encoder.layer` for the same points, if already computed.
            until: Group at which the layer is retired, the first without flags for it; None if never.

        Returns:
            The decoded points in reel order, and order [N]: order[i] is the index of the input point that became reel
            point i.
        """
        early = not self._manifest.groups and 0 <= group < self._manifest.first_group
        if not early:
            self._check_next(group)
            self._drop_from(group)
        self._pending = [layer for layer in self._pending if layer.group <= group]
        entry = FileEntry("", 0, "", first_frame, 0, len(gaussians), group, until=until)
        self._check_order(entry)
        if not len(gaussians):
            return gaussians, np.zeros(0, np.int64)
        files, order = encoded or self.encoder.layer(group, first_frame, gaussians, importance)
        parts = []
        for data in files:
            before = sum(layer.group == group for layer in self._pending)
            uri = f"layers/{group:04d}.{before}.safetensors" if before else f"layers/{group:04d}.safetensors"
            parts.append(decode_layer(data, uri)[1])
            self._pending.append(self._write(uri, data, replace(entry, uri=uri, points=len(parts[-1]))))
        return Gaussians.concatenate(parts), order

    def add_group(
        self,
        group: Group,
        importance: np.ndarray | None = None,
        encoded: dict[str, bytes] | None = None,
        overlap: int | None = None,
    ) -> Group:
        """Encode a group and update the manifest. Return the decoded group, with dynamic points in reel order.

        Args:
            group: Group to write.
            importance: See `add_layer`.
            encoded: Result of `encoder.group` for the same group, if already computed.
            overlap: Frames over which the group cross-fades with the one before; None for those of the header.

        Raises:
            ReelError: `alive` does not match the layers that live at the group.
        """
        self._check_next(group.index)
        self._drop_from(group.index)
        early = not self._manifest.groups
        born = [x for x in self._pending if x.group == group.index or (early and x.group < self._manifest.first_group)]
        layers = [*self._manifest.layers, *born]
        static = sum(layer.points for layer in layers if layer.lives_at(group.index))
        if group.alive.shape != (static,):
            raise ReelError(
                f"Group {group.index} has alive flags of {len(group.alive)} static points, but the layers "
                f"hold {static}. Add the layers of this group before it."
            )
        files = encoded or self.encoder.group(group, importance)
        blank = FileEntry("", 0, "", group.first_frame, group.frames, len(group.dynamic), group.index, overlap=overlap)
        entry, *others = (self._write(uri, data, replace(blank, uri=uri)) for uri, data in files.items())
        entry = replace(entry, renditions=dict(zip(self.encoder.others, others, strict=True)))
        self._write_manifest(self._manifest.with_files(layers, [*self._manifest.groups, entry]))
        self._pending = []
        return decode_group(files[entry.uri], entry.uri)

    def write_asset(self, uri: str, data: bytes) -> Asset:
        """Write an image or sound file for use in a presentation."""
        write_bytes(self.path / uri, data)
        return Asset(uri, len(data), hashlib.sha256(data).hexdigest())

    def present(self, presentation: Presentation) -> None:
        """Write another presentation, whose assets exist already, to the manifest. Assets that it no longer names are deleted."""
        self._replace(replace(self._manifest, presentation=presentation), live=self._manifest.live)

    def drop_before(self, group: int) -> None:
        """Drop earlier groups, their retired layers and their sound, for the retention window of a live reel.

        The manifest is written first. Groups in pages are dropped only by whole pages; the last group stays.

        Args:
            group: Number of the first group to keep.
        """
        manifest = self._manifest
        pages, first = list(manifest.pages), manifest.first_group
        while pages and first + pages[0].groups <= group:
            first += pages.pop(0).groups
        if not pages:
            first = max(first, min(group, manifest.end_group - 1))
        if first == manifest.first_group or not manifest.groups:
            return
        layers = (layer for layer in manifest.layers if layer.until is None or layer.until > first)
        kept = manifest.with_files(layers, manifest.groups[first - manifest.first_group :])
        presentation = manifest.presentation
        if presentation.sound is not None:
            presentation = replace(presentation, sound=presentation.sound.trimmed_before(kept.first_frame / kept.fps))
        kept = replace(kept, first_group=first, pages=tuple(pages), presentation=presentation)
        self._replace(kept, live=manifest.live)

    def finish(self) -> None:
        """Mark the reel as complete. Raise `ReelError` if it has no group."""
        if not self._manifest.groups:
            raise ReelError(f"{self.path}: a reel without a group cannot be finished.")
        self._write_manifest(self._manifest, live=False)

    def _check_header(self) -> None:
        file = self.path / MANIFEST
        try:
            parse_manifest(replace(self._manifest, renditions=()).to_json().encode(), str(file))
        except ValueError as error:
            raise ReelError(f"{file}: would hold NaN or infinity. Look for it in the capture.") from error

    def _without_damaged_assets(self, presentation: Presentation) -> Presentation:
        """Remove images and sound with a damaged file; the caller creates them again."""
        names = {name for name in ("poster", "thumbnails", "sound") if getattr(presentation, name) is not None}
        alone = {name: replace(EMPTY, **{name: getattr(presentation, name)}) for name in names}
        damaged = [name for name in names if not all(_is_intact(self.path, asset) for asset in alone[name].assets)]
        return replace(presentation, **dict.fromkeys(damaged))

    def _check_next(self, group: int) -> None:
        if not self._manifest.first_group <= group <= self._manifest.end_group:
            raise ReelError(f"{self.path}: group {group} cannot be added, the next one is {self._manifest.end_group}.")

    def _check_order(self, layer: FileEntry) -> None:
        least = max(layer.group, self._manifest.first_group)
        if layer.until is not None and layer.until <= least:
            raise ReelError(
                f"{self.path}: a layer of group {layer.group} until {layer.until} would never show; choose more than {least}."
            )
        if self._pending and birth_order(layer) < birth_order(self._pending[-1]):
            raise ReelError(
                f"{self.path}: a layer of group {layer.group} until {layer.until} cannot follow one of group "
                f"{self._pending[-1].group} until {self._pending[-1].until}. Add the longest-lived of a group first."
            )

    def _drop_from(self, group: int) -> None:
        """Remove a group and all later ones from the manifest, then delete their files. With the first group all layers go too."""
        manifest = self._manifest
        if group >= manifest.end_group:
            return
        layers = [entry for entry in manifest.layers if manifest.first_group < group > entry.group]
        self._replace(manifest.with_files(layers, manifest.groups[: group - manifest.first_group]), live=True)

    def _replace(self, manifest: Manifest, live: bool) -> None:
        """Write another manifest, then delete the files that it no longer names."""
        before = self._manifest.uris
        self._write_manifest(manifest, live)
        for uri in sorted(before - self._manifest.uris - {MANIFEST}):
            self._delete(uri)

    def _write_manifest(self, manifest: Manifest, live: bool = True) -> None:
        """Write manifest.json after its pages; delete it if there is no group."""
        manifest = self._paged(replace(manifest, live=live))
        if manifest.groups:
            write_bytes(self.path / MANIFEST, manifest.to_json().encode())
        else:
            self._delete(MANIFEST)
        self._manifest = manifest

    def _paged(self, manifest: Manifest) -> Manifest:
        """Write new pages as needed and return the manifest with them. Their number depends only on the number of groups."""
        pages = list(manifest.pages)
        own = len(manifest.groups) - manifest.paged
        while pages and own < self._page:
            own += pages.pop().groups
        while own >= 2 * self._page:
            groups = manifest.groups[len(manifest.groups) - own :][: self._page]
            page, data = make_page(manifest.layers, groups, manifest.renditions)
            write_bytes(self.path / page.uri, data)
            pages.append(page)
            own -= self._page
        return replace(manifest, pages=tuple(pages))

    def _write(self, uri: str, data: bytes, entry: FileEntry) -> FileEntry:
        write_bytes(self.path / uri, data)
        return replace(entry, bytes=len(data), sha256=hashlib.sha256(data).hexdigest())

    def _delete(self, uri: str) -> None:
        try:
            remove(self.path / uri)
        except OSError as error:
            raise ReelError(f"{self.path / uri}: cannot be deleted ({error.strerror}).") from error
