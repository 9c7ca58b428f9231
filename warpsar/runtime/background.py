"""What is done beside the work that asks for it: files written while the next image is made."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Queue


class Background:
    """Tasks done one after the other, in their order, in a thread of their own; of use for what releases Python's lock.

    `ahead` tasks may wait; who brings one more waits too. After a task that fails no further one is begun, and its
    exception is raised by the next `put`, or at the end of the `with` block, which ends when all tasks are done.
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
                except BaseException as error:  # whatever it is, it is raised where the task came from
                    self._failure = error

    def put(self, task: Callable[[], None]) -> None:
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
