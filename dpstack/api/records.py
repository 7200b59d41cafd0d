"""Read and Write of DP-V1 at one slave, to be awaited; I&M as typed records."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from dpstack.dp.setup import SlaveSetup
from dpstack.dp.v1.im import IM_INDEX, Im, Im0, build_call, number_of, parse_answer
from dpstack.dp.v1.ms1 import ReadRecord, RecordDone, WriteRecord
from dpstack.dp.v1.records import MAX_RECORD
from dpstack.errors import PduError, SlaveFault, UsageError
from dpstack.units import s_to_ns

if TYPE_CHECKING:
    from dpstack.api.services import Services

#: in seconds, for one service from the order on, those before it included
TIMEOUT: Final = 10.0


class Records:
    """The records of one slave."""

    def __init__(self, services: Services, setup: SlaveSetup) -> None:
        self._services = services
        self._setup = setup

    async def read(self, slot: int, index: int, length: int | None, timeout: float) -> bytes:
        """Up to ``length`` octets, None: as many as it can have."""
        token = self._services.token()
        wanted = self._longest if length is None else length
        command = ReadRecord(token, self._setup.address, slot, index, wanted, s_to_ns(timeout))
        return (await self._services.do(token, command, RecordDone)).outcome.data

    async def write(self, slot: int, index: int, data: bytes, timeout: float) -> None:
        """All of ``data``."""
        if self._longest < len(data) <= MAX_RECORD:
            raise UsageError(
                f"{self._who}: {len(data)} octets, its GSD file says C1_Max_Data_Len = {self._longest}: write less"
            )
        token = self._services.token()
        command = WriteRecord(token, self._setup.address, slot, index, bytes(data), s_to_ns(timeout))
        await self._services.do(token, command, RecordDone)

    async def im(self, number: int, slot: int, timeout: float) -> Im:
        """I&M ``number``: the call, then what it gives."""
        if not 0 <= number <= 4:
            raise UsageError(f"there is no I&M{number}: 0..4")
        await self.write(slot, IM_INDEX, build_call(number), timeout)
        octets = await self.read(slot, IM_INDEX, None, timeout)
        try:
            return parse_answer(octets, number)
        except PduError as error:
            raise SlaveFault(self._setup.address, f"{self._who} gives no I&M{number}: {error}") from None

    async def write_im(self, record: Im, slot: int, timeout: float) -> None:
        """I&M1 to 4."""
        if isinstance(record, Im0):
            raise UsageError("I&M0 is what the device is: it cannot be written")
        try:
            call = build_call(number_of(record), record)
        except PduError as error:
            raise UsageError(str(error)) from None
        await self.write(slot, IM_INDEX, call, timeout)

    @property
    def _longest(self) -> int:
        dpv1 = self._setup.dpv1
        return MAX_RECORD if dpv1 is None else dpv1.c1_max_data_len

    @property
    def _who(self) -> str:
        return f"slave {self._setup.address} ({self._setup.name})"
