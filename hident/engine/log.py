"""What happens in a run, told to the logger "hident" of the standard library: silent unless somebody listens.

Each record has a readable message, and in ``record.hident`` the same as fields: the name of the event first.
"""

from __future__ import annotations

import logging
from typing import Any

LOGGER = logging.getLogger("hident")
# Without a handler, Python would print warnings.
LOGGER.addHandler(logging.NullHandler())


def tell(event: str, message: str, **fields: Any) -> None:
    """Something happened as it should."""
    LOGGER.info("%s", message, extra={"hident": {"event": event, **fields}})


def warn(event: str, message: str, **fields: Any) -> None:
    """Something happened that should not."""
    LOGGER.warning("%s", message, extra={"hident": {"event": event, **fields}})
