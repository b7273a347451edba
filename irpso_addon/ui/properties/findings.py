"""What the check of a capture has found, kept in the scene's settings: what the panel shows, and what bars Recover."""

from __future__ import annotations

from collections.abc import Iterable

from ...capture.inspect.report import Finding


def is_checked(settings) -> bool:
    """Return whether findings are of the capture that is chosen now."""
    return settings.source == "SCENE" or settings.checked_path == settings.capture_path


def keep(settings, found: Iterable[Finding], known: str = "") -> None:
    """Keep findings as settings. known: how the paths in them begin, which is left out: a panel is narrow."""
    settings.findings.clear()
    for finding in found:
        item = settings.findings.add()
        item.severity, item.code, item.ask = finding.severity, finding.code, finding.ask
        item.message = finding.message.replace(known, "") if known else finding.message


def shown(settings) -> list:
    """Return the findings that matter for what is to be recovered now, errors first."""
    if not is_checked(settings):
        return []
    found = [item for item in settings.findings if item.ask != "normals" or wants_normal(settings)]
    return sorted(found, key=lambda item: item.severity != "error")


def wants_normal(settings) -> bool:
    """Return whether normals are to be recovered; a list that is not filled yet holds all parameters."""
    return not settings.parameters or any(item.is_normal and item.recover for item in settings.parameters)


def obstacle(settings) -> str:
    """Return why the files that are chosen cannot be used, "" where that is not known."""
    if settings.source != "FILES":  # a scene changes with every edit, and is looked at anew by Recover
        return ""
    first = next((item.message for item in shown(settings) if item.severity == "error"), "")
    return first and f"This capture cannot be used: {first}. Then check again"
