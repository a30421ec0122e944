"""The errors of this package; each carries one line that names the value, what is allowed and the remedy."""


class TrafficRoadError(Exception):
    """Base of every error that this package raises on purpose."""


class SceneError(TrafficRoadError, ValueError):
    """A scene, or a keyword of a public function, that cannot be used."""


class StabilityError(TrafficRoadError, ValueError):
    """A numerical method asked to work outside its stability limit."""


class StoreError(TrafficRoadError, OSError):
    """A file that cannot be read, written or understood."""
