"""The front end: each sweep of a log registered against the walls seen last."""

from specmap_cli.registration.frontend import FrontEnd

__all__ = ["FrontEnd"]
