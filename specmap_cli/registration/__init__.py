"""The front end: each sweep of a log registered against the walls seen last.

`FrontEnd` is the whole of it. How points are aligned is a method behind the protocol `Aligner`:
KISS-ICP unless `registration.method` names another, which any installed package can offer.
"""

from specmap_cli.registration.aligner import Aligner, SensorKind
from specmap_cli.registration.frontend import FrontEnd

__all__ = ["Aligner", "FrontEnd", "SensorKind"]
