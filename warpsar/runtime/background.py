"""Tasks done beside the main work, such as files written while the next image is made."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Queue


class Background:
    """A thread that does tasks one after the other, in their order. It helps with what releases Python's lock.

    Up to `ahead` tasks wait; `put` blocks until there is room. After a task fails, no further one begins. Its exception
    is raised by the next `put`, or at the end of the `with` block, which waits for all tasks.
    """

    def __init__(self, ahead: int) -> None:
        self._tasks: Queue[Callable[[], None] | None] = Queue(ahead)
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        while (task := self._tasks.get()) is not None:
            if self._failure is None:
                try:
                    task()
                except BaseException as error:  # raised again where the task came from
                    self._failure = error

    def put(self, task: Callable[[], None]) -> None:
        """Add a task; raises the exception of one that failed."""
        self._refuse()
        self._tasks.put(task)

    def _refuse(self) -> None:
        if self._failure is not None:
            raise self._failure

    def __enter__(self) -> Background:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._tasks.put(None)
        self._thread.join()
        if kind is None:
            self._refuse()
