"""Feet that stand: which place of a foot is on the floor when, and where it must stay.

A place of a foot (heel, ball) stands while it is low and slow (after Kovar et al. 2002, "Footskate cleanup for motion
capture editing"). While it stands it is held at the middle of where it was; before and after, the hold fades.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from markerloom.errors import FormatError, InputError
from markerloom.formats.files import read_text, write_text
from markerloom.skeleton.motion import Motion
from markerloom.skeleton.skeleton import Skeleton

Array = NDArray[np.floating[Any]]
Pin = tuple[int, int, list[float], list[float], float]
FEET = ("heel", "ball")
SLOW_M_PER_S, LOW_M = 0.20, 0.035
"""A place that stands moves less than this, and is not higher above its lowest than this."""
STAYS_M = 0.010
"""While it stands, all its places are within this: holding it moves it by less."""
STANDS_S, FADES_S = 0.12, 0.12
"""It stands at least so long; before and after, the hold fades over so long (s)."""
HELD_M, FADING_M, LOOSE_M = 1e-4, 0.003, 0.05
"""How firmly a standing place is held, one whose hold begins to fade, and one whose hold has faded (m)."""


@dataclass(frozen=True)
class Contact:
    """A place of a foot that stands from frame ``start`` to before ``stop`` (numbers of frames of the motion)."""

    site: str
    start: int
    stop: int


def find_contacts(motion: Motion) -> list[Contact]:
    """Where the skeleton's places of feet stand; only in frames whose markers tell where the foot is."""
    places = motion.sites_m()
    out = []
    for i, site in enumerate(motion.skeleton.sites):
        if site.name.rpartition("_")[2] not in FEET or len(motion) < 3:
            continue
        height = _smooth(places[:, i], motion.rate_hz)
        speed = np.linalg.norm(np.gradient(height, axis=0), axis=1) * motion.rate_hz
        low = height[:, 2] < np.percentile(height[:, 2], 3) + LOW_M
        out += [
            Contact(site.name, motion.first_frame + a, motion.first_frame + b)
            for first, last in runs(low & (speed < SLOW_M_PER_S) & _told(motion, site.joint))
            for a, b in _in_place(places[first:last, i], first)
            if b - a >= STANDS_S * motion.rate_hz
        ]
    return sorted(out, key=lambda c: (c.start, c.site))


def _told(motion: Motion, joint: int) -> NDArray[np.bool_]:
    """In which frames markers tell where a segment is; one that never has any is where the one above it is."""
    while joint > 0 and motion.kind[:, joint].all():
        joint = motion.skeleton.parents[joint]
    return np.asarray(motion.kind[:, joint] == 0)


def _in_place(places: Array, first: int) -> list[tuple[int, int]]:
    """Parts of a slow stretch (frames, 3) within which the place stays where it is: what creeps is not held."""
    out, start = [], 0
    low = high = places[0]
    for f, here in enumerate(places):
        low, high = np.minimum(low, here), np.maximum(high, here)
        if np.linalg.norm(high - low) > STAYS_M:
            out.append((first + start, first + f))
            start, low, high = f, here, here
    return [*out, (first + start, first + len(places))]


def _smooth(places: Array, rate_hz: float) -> Array:
    """A short average, so that noise is no speed."""
    half = max(1, round(0.02 * rate_hz))
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    padded = np.pad(places, ((half, half), (0, 0)), mode="edge")
    return np.stack([np.convolve(padded[:, k], kernel, mode="valid") for k in range(3)], axis=1)


def runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Where a mask is true: beginnings, and ends before which it is."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def pins_of(motion: Motion, contacts: list[Contact]) -> list[Pin]:
    """Places that the engine must hold: frame, joint, place in the segment, target (m, world), how firmly (m)."""
    places = motion.sites_m()
    names = [s.name for s in motion.skeleton.sites]
    fade = max(1, round(FADES_S * motion.rate_hz))
    for contact in contacts:
        if contact.site not in names:
            raise InputError(f"contacts: skeleton '{motion.skeleton.name}' has no place '{contact.site}'")
        if not motion.first_frame <= contact.start < contact.stop <= motion.first_frame + len(motion):
            raise InputError(f"contacts: frames {contact.start}:{contact.stop} of '{contact.site}' are not in the take")
    targets = _targets(motion, contacts, places, names)
    pins: list[Pin] = []
    for contact in contacts:
        i = names.index(contact.site)
        site = motion.skeleton.sites[i]
        a, b = contact.start - motion.first_frame, contact.stop - motion.first_frame
        target, told = targets[contact], _told(motion, site.joint)
        pins += [(f, site.joint, list(site.place_m), target.tolist(), HELD_M) for f in range(a, b)]
        others = [(c.start, c.stop) for c in contacts if c.site == contact.site and c is not contact]
        for edge, step in ((a, -1), (b - 1, 1)):
            off = target - places[edge, i]
            for n in range(1, fade):
                f = edge + step * n
                number = f + motion.first_frame
                if not 0 <= f < len(motion) or not told[f] or any(s <= number < e for s, e in others):
                    break
                gone = n / fade
                held = (1.0 - gone) ** 2 * (1.0 + 2.0 * gone)
                firmly = FADING_M * (LOOSE_M / FADING_M) ** gone
                pins.append((f, site.joint, list(site.place_m), (places[f, i] + held * off).tolist(), firmly))
    return pins


def _targets(motion: Motion, contacts: list[Contact], places: Array, names: list[str]) -> dict[Contact, Array]:
    """Where each standing place is held (m). Two places of one foot that stand at the same time are held as far from
    each other as the bone between them is long.
    """
    first = motion.first_frame
    targets: dict[Contact, Array] = {}
    for contact in sorted(contacts, key=lambda c: (c.start - c.stop, c.start, c.site)):
        i = names.index(contact.site)
        own = np.median(places[contact.start - first : contact.stop - first, i], axis=0)
        for other, held in targets.items():
            start, stop = max(contact.start, other.start), min(contact.stop, other.stop)
            if other.site[:2] != contact.site[:2] or other.site == contact.site or stop <= start:
                continue
            apart = (
                places[start - first : stop - first, i] - places[start - first : stop - first, names.index(other.site)]
            )
            mean = apart.mean(axis=0)
            own = held + mean * (np.linalg.norm(apart, axis=1).mean() / max(float(np.linalg.norm(mean)), 1e-9))
            break
        targets[contact] = own
    return targets


def slides_mm(motion: Motion, contacts: list[Contact]) -> list[dict[str, Any]]:
    """Of each contact: how far the place slides on the floor and how far it sinks or rises while it stands (mm)."""
    places = motion.sites_m()
    names = [s.name for s in motion.skeleton.sites]
    out = []
    for contact in contacts:
        own = places[contact.start - motion.first_frame : contact.stop - motion.first_frame, names.index(contact.site)]
        flat = np.linalg.norm(own[:, :2] - np.median(own[:, :2], axis=0), axis=1).max()
        sinks = np.abs(own[:, 2] - np.median(own[:, 2])).max()
        out.append(
            {
                "site": contact.site,
                "start": contact.start,
                "stop": contact.stop,
                "slides_mm": 1000.0 * float(flat),
                "sinks_mm": 1000.0 * float(sinks),
            }
        )
    return out


def read_contacts(path: str | Path, skeleton: Skeleton) -> list[Contact]:
    """Contacts from a table with the columns site, start, stop."""
    rows = list(csv.DictReader(io.StringIO(read_text(path))))
    if rows and not {"site", "start", "stop"} <= set(rows[0]):
        raise FormatError(path, "a table of contacts has the columns site, start, stop")
    out = []
    for number, row in enumerate(rows, start=2):
        try:
            contact = Contact(row["site"], int(row["start"]), int(row["stop"]))
        except (TypeError, ValueError):
            raise FormatError(path, "start and stop are numbers of frames", where=f"line {number}") from None
        if contact.site not in [s.name for s in skeleton.sites] or contact.stop <= contact.start:
            raise FormatError(path, f"no contact of skeleton '{skeleton.name}'", where=f"line {number}")
        out.append(contact)
    return out


def write_contacts(contacts: list[Contact], path: str | Path) -> None:
    """Write contacts as a table that can be edited."""
    write_text(path, "\n".join(["site,start,stop", *(f"{c.site},{c.start},{c.stop}" for c in contacts)]) + "\n")
