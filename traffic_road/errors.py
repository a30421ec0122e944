"""The errors of this package; each carries one line that names the value, what is allowed and the remedy."""


class TrafficRoadError(Exception):
    """Base of every error that this package raises on purpose."""


class SceneError(TrafficRoadError, ValueError):
    """A scene, or a keyword of a public function, that cannot be used."""


class StabilityError(TrafficRoadError, ValueError):
    """A numerical method asked to work outside its stability limit."""


class StoreError(TrafficRoadError, OSError):
    """A file that cannot be read, written or understood."""


def shown(value) -> str:
    """`value` in one short line, for a message."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # an int of more digits than Python prints
        return f"<{type(value).__name__} too long to print>"
    return text if len(text) <= 80 else text[:77] + "..."
