"""Contacts of feet as somebody marked them, over those that were found."""

from __future__ import annotations

from markerloom.mending.edits import MarkContact
from markerloom.skeleton.contacts import Contact


def marked(found: list[Contact], marks: list[MarkContact]) -> list[Contact]:
    """Contacts after marks, in order: a mark decides about its frames, whatever was found there."""
    contacts = found
    for mark in marks:
        start, stop = mark.within.first, mark.within.last + 1
        contacts = [part for c in contacts for part in _without(c, mark.site, start, stop)]
        if mark.stands:
            contacts = [*contacts, Contact(mark.site, start, stop)]
    return sorted(contacts, key=lambda c: (c.start, c.site))


def _without(contact: Contact, site: str, start: int, stop: int) -> list[Contact]:
    """What is left of a contact outside some frames."""
    if contact.site != site:
        return [contact]
    parts = [(contact.start, min(contact.stop, start)), (max(contact.start, stop), contact.stop)]
    return [Contact(site, a, b) for a, b in parts if a < b]
