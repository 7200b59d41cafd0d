"""A request that its user gives again and again."""

from __future__ import annotations

from dpstack.fdl.codec import NO_FRAME, KeptFrame


class Standing:
    """The part of a request that stays, if its user gives the object again when it has got its result. The request has
    no SAPs, and FCB and FCV.

    ``quiet``: the station does not call :meth:`~dpstack.fdl.interface.LinkUser.started`, but sets ``at`` to the time.
    The rest is the station's own: the frames by FCB and FCV, that of the likely answer, and the counts of requests and
    answers that its counters lack.
    """

    __slots__ = ("answer", "answers", "at", "frames", "quiet", "requests")

    def __init__(self, *, quiet: bool = False) -> None:
        self.quiet = quiet
        self.at = 0
        self.frames: dict[int, KeptFrame] = {}
        self.answer = NO_FRAME
        self.requests = self.answers = 0
