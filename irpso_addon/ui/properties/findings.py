"""Findings of the capture check, stored in the scene's settings: the panel shows them, and errors block Recover."""

from __future__ import annotations

from collections.abc import Iterable

from ...capture.inspect.frames import Finding
from ..common.words import iface


def is_checked(settings) -> bool:
    """Return whether the findings belong to the current capture."""
    return settings.source == "SCENE" or settings.checked_path == settings.capture_path


def keep(settings, new: Iterable[Finding], known: str = "") -> None:
    """Store findings in the settings. known: a prefix removed from their paths, because a panel is narrow."""
    settings.findings.clear()
    for finding in new:
        item = settings.findings.add()
        item.severity, item.code, item.goal = finding.severity, finding.code, finding.goal
        item.message = finding.message.replace(known, "") if known else finding.message


def shown(settings) -> list:
    """Return the findings that concern the maps to be recovered, errors first."""
    if not is_checked(settings):
        return []
    found = [item for item in settings.findings if item.goal != "normals" or wants_normal(settings)]
    return sorted(found, key=lambda item: item.severity != "error")


def wants_normal(settings) -> bool:
    """Return whether normals are to be recovered. An empty list stands for all parameters."""
    return not settings.parameters or any(item.is_normal and item.recover for item in settings.parameters)


def obstacle(settings) -> str:
    """Return the first error of the chosen files as a sentence, "" if none is known."""
    if settings.source != "FILES":  # a scene changes with every edit: Recover checks it itself
        return ""
    first = next((item.message for item in shown(settings) if item.severity == "error"), "")
    return first and iface("This capture cannot be used: {fault}. Then check again", fault=first)
