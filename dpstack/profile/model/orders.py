"""The orders of one drive that are under way, and the events that tell of them."""

from __future__ import annotations

from dpstack.profile.model.jobs import CommandError, ErrorKind, Job


class Orders:
    """Jobs in the order in which they came; each is resumed once a cycle and ends with a result event."""

    __slots__ = ("_events", "_jobs")

    def __init__(self) -> None:
        self._jobs: list[Job] = []
        self._events: list[dict[str, object]] = []

    def begin(self, job: Job) -> None:
        """A new order; one that moves the drive supersedes the one that did."""
        if job.motion:
            for other in [other for other in self._jobs if other.motion]:
                self._drop(other)
                self._failed(other.token, "usage", f"{other.op} was superseded by {job.op}")
        self._jobs.append(job)
        self._resume(job)

    def spawn(self, job: Job) -> None:
        """A job of the plugin's own: it begins with the next cycle."""
        self._jobs.append(job)

    def step(self) -> None:
        """Another cycle."""
        if self._jobs:
            for job in tuple(self._jobs):
                self._resume(job)

    def end(self, kind: ErrorKind, text: str) -> None:
        """All end, for this reason."""
        jobs, self._jobs = self._jobs, []
        for job in jobs:
            job.steps.close()
            self._failed(job.token, kind, text)

    def cancel(self, token: int | None) -> int:
        """Nobody waits for this order any more: it ends without a result. How many that were."""
        ended = [job for job in self._jobs if job.token == token and token is not None]
        for job in ended:
            self._drop(job)
        return len(ended)

    def refused(self, token: int, error: CommandError) -> None:
        """An order that was not begun."""
        self._failed(token, error.kind, error.text, error.number)

    def tell(self, event: dict[str, object]) -> None:
        """Anything else for the application."""
        self._events.append(event)

    def take_events(self) -> list[dict[str, object]]:
        """Plain JSON data for the application, oldest first."""
        if not self._events:
            return []
        events, self._events = self._events, []
        return events

    def _drop(self, job: Job) -> None:
        self._jobs.remove(job)
        job.steps.close()

    def _resume(self, job: Job) -> None:
        if job not in self._jobs:
            return
        try:
            next(job.steps)
            return
        except StopIteration as done:
            result: dict[str, object] = done.value
        except CommandError as error:
            self._jobs.remove(job)
            self._failed(job.token, error.kind, error.text, error.number)
            return
        except BaseException:
            self._jobs.remove(job)
            raise
        self._jobs.remove(job)
        if job.token is not None:
            self._events.append({"type": "result", "token": job.token, "ok": True, **result})

    def _failed(self, token: int | None, kind: ErrorKind, text: str, number: int | None = None) -> None:
        if token is not None:
            error = {"error": kind, "number": number, "text": text}
            self._events.append({"type": "result", "token": token, "ok": False, **error})
