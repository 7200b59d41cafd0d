"""Master side of an encoder: the order that gives its position a value."""

from __future__ import annotations

from typing import Final

from dpstack.devices.model import EncoderFile
from dpstack.dp.counter import Counter
from dpstack.errors import ConfigError
from dpstack.profile.master.device_core import DeviceCore
from dpstack.profile.model.drive_type import DriveType, Options, TelegramSpec
from dpstack.profile.model.jobs import Args, CommandError, Steps
from dpstack.units import NS_PER_MS

PRESET: Final = "preset"


class EncoderCore(DeviceCore):
    """The encoder in ``file``. Its order :data:`PRESET` takes ``value``, the position from now on, or ``turns``; and
    ``tolerance``, the counts that it may move until it is confirmed.

    The strobe is 0 except while the order runs: no value is set when the encoder was away and comes back.
    """

    def __init__(
        self, file: EncoderFile, profile: DriveType, name: str, telegram: TelegramSpec, options: Options
    ) -> None:
        super().__init__(profile.name, name, telegram)
        self.file = file
        position, preset = file.part(telegram.name, "position"), file.part(telegram.name, PRESET, outputs=True)
        if position is None:
            raise ConfigError(f"{file.name} has no telegram {telegram.name!r}; it has {', '.join(file.telegrams)}")
        self._word, self._at = position
        self._preset_at = preset
        if preset is not None:
            self.operations = {PRESET: file.preset_timeout_ms / 1000}
        self._counter = counter_of(file, telegram.name, options)
        self._turn = float(options["counts_per_turn"])
        done = file.preset_done
        #: bit of the position's word that confirms a preset; None: in this telegram the position does
        self._bit = self._word.bits.get(done)
        self._by_time = done == "time"
        self._low_since: int | None = None
        self._beyond = False

    def received(self) -> None:
        """Report counts that the range cannot have, once."""
        if self._counts >= self._counter.range and not self._beyond:
            self._beyond = True
            self.notice(
                f"its position is {self._counts}, and its range ends at {self._counter.range - 1}: compare range and "
                "counts_per_turn with its parameters"
            )

    def lost(self, now: int) -> None:
        super().lost(now)
        self._low_since, self._beyond = None, False

    def order(self, op: str, args: Args, deadline: int) -> Steps[dict[str, object]]:
        value, turns = args.optional("value"), args.optional("turns")
        tolerance = args.optional("tolerance") or 0
        if (value is None) is (turns is None):
            raise CommandError("usage", f"{op} takes the position: value = 1000, or turns = 2.5")
        if turns is not None:
            if not self._turn:
                raise CommandError("usage", f"{op}: nobody knows how many counts a turn has: give value")
            value = round(turns * self._turn)
        if value is None or value != int(value):
            raise CommandError("usage", f"{op}: value = {value:g} is no whole number of counts")
        try:
            counts = self._counter.counts(int(value))
        except ValueError as error:
            raise CommandError("usage", f"{op}: {error}") from None
        word = self._preset_word()
        if counts >= 1 << word - 1:
            raise CommandError("usage", f"{op}: {counts} counts need more than the {word - 1} bits beside the strobe")
        return self._preset(counts, tolerance, deadline)

    # -- inside ------------------------------------------------------------------------------------------------------

    @property
    def _raw(self) -> int:
        return int.from_bytes(self.inputs[self._at : self._at + self._word.octets], "big")

    @property
    def _counts(self) -> int:
        return self._raw & ((1 << (self._word.width or 8 * self._word.octets)) - 1)

    @property
    def _confirmed(self) -> bool:
        return self._bit is not None and bool(self._raw >> self._bit & 1)

    def _preset_word(self) -> int:
        """Bits of the preset word."""
        assert self._preset_at is not None
        return 8 * self._preset_at[0].octets

    def _send(self, counts: int, *, strobe: bool) -> None:
        assert self._preset_at is not None
        word, at = self._preset_at
        number = counts | (strobe << 8 * word.octets - 1)
        after = len(self.safe_outputs) - at - word.octets
        self.outputs = self.safe_outputs[:at] + number.to_bytes(word.octets, "big") + bytes(after)

    def _preset(self, counts: int, tolerance: float, deadline: int) -> Steps[dict[str, object]]:
        if self._low_since is None:
            self._low_since = self.now
        shown = self._counter.shown(counts)
        # the device must have seen the strobe at 0, or it sees no edge
        while self.now < self._low_since + self.settle_ns or self._confirmed:
            if self.now >= deadline:
                raise CommandError("timeout", "it still confirms an earlier preset, or the order has too little time")
            yield
        try:
            self._send(counts, strobe=True)
            held = self.now + max(self.settle_ns, self.file.preset_hold_ms * NS_PER_MS)
            while self.now < held or not self._is_done(counts, tolerance):
                if self.now >= deadline:
                    raise CommandError("timeout", self._why_not(counts))
                yield
        finally:
            self._send(counts, strobe=False)
            self._low_since = self.now
        return {"value": shown}

    def _is_done(self, counts: int, tolerance: float) -> bool:
        if self._by_time:
            return True
        if self._bit is not None:
            return self._confirmed
        return self._counter.distance(self._counts, counts) <= tolerance

    def _why_not(self, counts: int) -> str:
        if self._by_time:
            return "the order has too little time for the strobe"
        if self._bit is not None:
            return "it does not confirm the preset; are its class 2 functions on?"
        at, wanted = self._counter.shown(self._counts % self._counter.range), self._counter.shown(counts)
        return (
            f"its position is {at}, not {wanted}. It may have taken the preset and turned on: look at its position. "
            "Does its shaft stand still, and are its class 2 functions on? For a shaft that turns give tolerance=COUNTS"
        )


def counter_of(file: EncoderFile, telegram: str, options: Options) -> Counter:
    """The counter of the position in a telegram, with the options of the encoder."""
    place = file.part(telegram, "position")
    assert place is not None
    word, _ = place
    limit = 1 << (word.width or 8 * word.octets)
    return Counter(
        min(round(float(options["range"])) or limit, limit),
        backwards=bool(options["backwards"]),
        signed=bool(options["signed"]),
    )
