"""`Newest`: a thread for work that its requests overtake."""

import threading
from collections.abc import Callable
from typing import Any


class Newest(threading.Thread):
    """One thread that works on whatever changed; values that were overtaken while it was busy are
    never computed.
    """

    def __init__(self, work: Callable[[dict[str, Any]], None]):
        super().__init__(daemon=True)
        self._work, self._waiting, self._stopped = work, None, False
        self._news = threading.Condition()

    def put(self, **changes: Any) -> None:
        """Ask for some changes, on top of those that still wait."""
        with self._news:
            self._waiting = {**(self._waiting or {}), **changes}
            self._news.notify_all()

    def quiet(self, seconds: float) -> bool:
        """Whether nothing comes for so long; for the work itself to ask."""
        with self._news:
            return not self._news.wait_for(
                lambda: self._waiting is not None or self._stopped, seconds
            )

    def stop(self) -> None:
        """Leave after the work in hand."""
        with self._news:
            self._stopped = True
            self._news.notify_all()

    def run(self) -> None:
        """Work until `stop`."""
        while True:
            with self._news:
                self._news.wait_for(lambda: self._waiting is not None or self._stopped)
                if self._stopped:
                    return
                changes, self._waiting = self._waiting or {}, None
            self._work(changes)
