"""Octets of PROFIBUS PA that makers print: directories, block objects, status octets, DIAGNOSIS, blocks in Slave_Diag.

Each row has its document and page; the words are data in our own wording. Where a page has a misprint, the row says so.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class Source(NamedTuple):
    """``place``: where a public copy can be read."""

    maker: str
    device: str
    document: str
    page: str
    place: str


OXYMAT = Source(
    "Siemens",
    "OXYMAT 6",
    "A5E00054148-03",
    "56, 60, 71, 134",
    "easymanua.ls siemens/oxymat-6 p.56, p.60; manualshive 381093",
)
TRANSMAG = Source("Siemens", "SITRANS F TRANSMAG 2", "A5E00102775-AC", "110 to 113", "manualshive 381343")
LR260 = Source("Siemens", "SITRANS LR260", "A5E32337685", "124", "lr260 user's manual, page 130 of the copy")
LR250 = Source("Siemens", "SITRANS LR250", "A5E32221386-AC", "270, 273", "manualshive 381423")
LR400 = Source("Siemens", "SITRANS LR 400", "7ML19985FH04", "101", "lr400 user's manual, page 102 of the copy")
GA700 = Source(
    "Siemens",
    "SIPROCESS GA700",
    "A5E31930478-05",
    "286, 287",
    "manualslib 2972162, easymanua.ls p.287 (the same octets by Modbus)",
)
PROBE_LU = Source("Siemens", "SITRANS Probe LU", "7ML19985JB02", "29", "easymanua.ls siemens/sitrans-probe-lu p.35")
MM2700 = Source(
    "Emerson",
    "Micro Motion 2700",
    "configuration and use manual with PROFIBUS-PA",
    "138, 139, 153, 171, 181, 184",
    "manualsonline model_2700",
)
ABB_IG = Source("ABB", "Sensyflow iG", "42/14-39 EN", "24", "manualshive 4508")
FMR240 = Source("Endress+Hauser", "Micropilot M FMR 240", "operating instructions", "46", "manualshive 2407980")
FLOW93 = Source("Endress+Hauser", "Prosonic Flow 93", "operating instructions", "112", "manualslib 3196702")
PROMAG500 = Source("Endress+Hauser", "Promag H 500", "operating instructions", "170", "manualshive 2408078")
TMT84 = Source(
    "Endress+Hauser", "iTEMP TMT84", "operating instructions", "97", "easymanua.ls endressplushauser/itemp-tmt84 p.97"
)
VEGABAR = Source("VEGA", "VEGABAR 63", "32463-EN-081209", "63", "azmanual 263316")
UFC400 = Source("Krohne", "UFC 400", "AD UFC 400 PROFIBUS R02", "26", "azmanual 369499")
MFC300 = Source("Krohne", "MFC 300", "AD MFC 300 PROFIBUS R02", "28", "azmanual 369055")
IPT11 = Source("WIKA", "IPT-11", "31547-EN-081211", "52", "manualshive 980482")
POLYTRON = Source("Dräger", "Polytron 7000", "manual", "85", "easymanua.ls drager/polytron-7000 p.85")
SAMSON = Source("Samson", "3730-4", "KH 8384-4 EN", "31, 32", "easymanua.ls samson/3730-4 p.31; manualshive 3871966")
TRICOR = Source("TRICOR", "TCD", "TCD_PROFI_S_EN_200326_E003", "14", "manualshive 1162150")
F2D0 = Source("Pepperl+Fuchs", "F2D0-MIO-Ex12.PA", "07/2018", "43", "manualshive 1527761")
KLAY = Source("Klay", "series 4000", "NL-4000-PROFIBUS-PA-04-2023", "27", "manualslib.nl 105933")


# --- directories ----------------------------------------------------------------------------------------------------


class Entry(NamedTuple):
    """A block. ``kind``: PB, TB or FB; ``at``: slot and index of its first parameter; ``parameters`` None: "xxx"."""

    kind: str
    at: tuple[int, int]
    parameters: int | None


class Directory(NamedTuple):
    """``records``: index in ``slot`` and its octets. Where the page prints "xxx", the octets are the count of the block
    object that the same manual prints, or 0."""

    source: Source
    slot: int
    records: dict[int, str]
    blocks: list[Entry]


DIRECTORIES: Final = [
    # the entries are numbered on over three records, though Num_Dir_Obj is 1; the number of parameters of the
    # transducer blocks is printed as xxx, for which 0030 stands here
    Directory(
        OXYMAT,
        1,
        {
            0: "0000 0001 0001 000D 0001 0003",
            1: "0104 0001 0205 0004 0309 0005 016E 0036",
            2: "0142 0030 0242 0030 0342 0030 0442 0030",
            3: "0110 002D 0210 002D 0310 002D 0410 002D 0510 002D",
        },
        [
            Entry("PB", (1, 110), 54),
            Entry("TB", (1, 66), None),
            Entry("TB", (2, 66), None),
            Entry("TB", (3, 66), None),
            Entry("TB", (4, 66), None),
            Entry("FB", (1, 16), 45),
            Entry("FB", (2, 16), 45),
            Entry("FB", (3, 16), 45),
            Entry("FB", (4, 16), 45),
            Entry("FB", (5, 16), 45),
        ],
    ),
]


# --- block objects --------------------------------------------------------------------------------------------------


class BlockObject(NamedTuple):
    """DS-32: ``octets`` and its elements as printed. ``view``: slot and index of view 1; ``profile_revision`` 3.01 as
    (3, 1)."""

    source: Source
    name: str
    octets: str
    block: int
    parent: int
    class_: int
    profile: int
    profile_revision: tuple[int, int]
    parameters: int
    view: tuple[int, int]
    views: int


BLOCK_OBJECTS: Final = [
    BlockObject(
        OXYMAT, "PB", "FA 01 05 FA 00 00 00 00 00 00 40 02 03 00 00 00 36 01 B7 01",
        1, 5, 250, 0x4002, (3, 0), 54, (1, 183), 1,
    ),
    BlockObject(
        OXYMAT, "AI4", "FA 02 01 01 00 00 00 00 00 00 40 01 03 00 00 00 2D 04 41 01",
        2, 1, 1, 0x4001, (3, 0), 45, (4, 65), 1,
    ),
    BlockObject(
        OXYMAT, "DO", "FA 02 02 02 00 00 00 00 00 00 40 02 03 00 00 00 2D 05 4B 01",
        2, 2, 2, 0x4002, (3, 0), 45, (5, 75), 1,
    ),
    BlockObject(
        MM2700, "PB", "FA 01 01 FA 00 00 00 00 00 00 40 02 03 01 00 00 1A 00 31 01",
        1, 1, 250, 0x4002, (3, 1), 26, (0, 49), 1,
    ),
    BlockObject(
        MM2700, "TB1", "FA 03 03 03 00 00 00 00 00 00 40 02 03 01 00 00 FE 0B FE 01",
        3, 3, 3, 0x4002, (3, 1), 254, (11, 254), 1,
    ),
    BlockObject(
        MM2700, "AI1", "FA 02 01 01 00 00 00 00 00 00 40 02 03 01 00 00 2D 01 3D 01",
        2, 1, 1, 0x4002, (3, 1), 45, (1, 61), 1,
    ),
    BlockObject(
        MM2700, "AO2", "FA 02 02 01 00 00 00 00 00 00 40 02 03 01 00 00 31 0A 41 01",
        2, 2, 1, 0x4002, (3, 1), 49, (10, 65), 1,
    ),
    # Reserved is 0 here; what the others call DD_Reference is Dev_Rev and Dev_Rev_Comp
    BlockObject(
        KLAY, "TB", "00 03 F4 FA 00 01 00 01 00 00 40 02 03 02 00 00 34 05 F8 01",
        3, 244, 250, 0x4002, (3, 2), 52, (5, 248), 1,
    ),
]  # fmt: skip


# --- status octets --------------------------------------------------------------------------------------------------

CLASSIC, CONDENSED = "pa-classic", "pa-condensed"


class Status(NamedTuple):
    """``octets``: one, or the first and the last of a range. ``says``: words that the text has to have; "" for a good
    value without a remark. ``misprint``: the octet that the page prints, if its words belong to another one."""

    source: Source
    coding: str
    octets: str
    quality: str
    says: str
    misprint: str = ""


def _rows(source: Source, coding: str, text: str) -> list[Status]:
    """Lines ``octets quality words``."""
    lines = (line.split(maxsplit=2) for line in text.strip().splitlines())
    return [Status(source, coding, parts[0], parts[1], parts[2] if len(parts) > 2 else "") for parts in lines]


STATUS: Final = [
    *_rows(
        TRANSMAG,
        CLASSIC,
        """
        1F bad out of service, constant
        0F bad device failure, constant
        0C bad device failure
        07 bad configuration error, constant
        00 bad not specific
        52 uncertain sensor conversion not accurate, high limit
        51 uncertain sensor conversion not accurate, low limit
        4F uncertain initial value, constant
        4B uncertain substitute set, constant
        47 uncertain last usable value, constant
        8E good active critical alarm, high limit
        8D good active critical alarm, low limit
        8A good active advisory alarm, high limit
        89 good active advisory alarm, low limit
        84 good update event
        80 good
        """,
    ),
    *_rows(
        LR400,
        CLASSIC,
        """
        1F bad out of service
        0F bad device failure, constant
        0C bad device failure
        13 bad sensor failure, constant
        12 bad sensor failure, high limit
        11 bad sensor failure, low limit
        10 bad sensor failure
        07 bad configuration error, constant
        52 uncertain sensor conversion not accurate
        4F uncertain initial value
        4C uncertain initial value
        4B uncertain substitute set
        47 uncertain last usable value
        42 uncertain not specific, high limit
        41 uncertain not specific, low limit
        40 uncertain not specific
        8E good active critical alarm, high limit
        8D good active critical alarm, low limit
        8A good active advisory alarm, high limit
        89 good active advisory alarm, low limit
        84 good update event
        80 good
        """,
    ),
    *_rows(
        ABB_IG,
        CLASSIC,
        """
        00-03 bad not specific
        04-07 bad configuration error
        0C-0F bad device failure
        10-13 bad sensor failure
        1C-1F bad out of service
        40-43 uncertain not specific
        44-47 uncertain last usable value
        54-57 uncertain range of the unit violated
        84-87 good update event
        88-8B good active advisory alarm
        8C-8F good active critical alarm
        90-93 good unacknowledged update event
        94-97 good unacknowledged advisory alarm
        98-9B good unacknowledged critical alarm
        A4-A7 good maintenance required
        """,
    ),
    *_rows(
        FMR240,
        CLASSIC,
        """
        0C bad device failure
        0F bad device failure
        1F bad out of service
        40 uncertain not specific
        47 uncertain last usable value
        4B uncertain substitute set
        4F uncertain initial value
        5C uncertain configuration error
        80 good
        84 good update event
        89 good low limit
        8A good high limit
        8D good low limit
        8E good high limit
        """,
    ),
    *_rows(
        FLOW93,
        CLASSIC,
        """
        1C-1F bad out of service
        10-12 bad sensor failure
        0C-0F bad device failure
        18 bad no communication
        08-0B bad not connected
        40-43 uncertain not specific
        44-47 uncertain last usable value
        48-4B uncertain substitute set
        4C-4F uncertain initial value
        50-53 uncertain sensor conversion not accurate
        60-63 uncertain simulated value
        84-87 good update event
        8C-8F good active critical alarm
        88-8B good active advisory alarm
        """,
    ),
    # VEGA and WIKA call 0C a sensor failure; the profile and the others a device failure
    *(
        row
        for source in (VEGABAR, IPT11)
        for row in _rows(
            source,
            CLASSIC,
            """
            00 bad not specific
            04 bad configuration error
            0C bad device failure
            10 bad sensor failure
            1F bad out of service, constant
            44 uncertain last usable value
            48 uncertain substitute set
            4C uncertain initial value
            51 uncertain sensor conversion not accurate, low limit
            52 uncertain sensor conversion not accurate, high limit
            80 good
            84 good update event
            89 good active advisory alarm, low limit
            8A good active advisory alarm, high limit
            8D good active critical alarm, low limit
            8E good active critical alarm, high limit
            """,
        )
    ),
    *_rows(
        MM2700,
        CLASSIC,
        """
        0C bad device failure
        10 bad sensor failure
        04 bad configuration error
        00 bad not specific
        60 uncertain simulated value
        64 uncertain sensor calibration
        5C uncertain configuration error
        40 uncertain not specific
        4C uncertain initial value
        88 good active advisory alarm
        84 good update event
        C0 good
        44 uncertain last usable value
        """,
    ),
    # "out of service, limit constant" with the octet of the one without limits
    Status(MM2700, CLASSIC, "1F", "bad", "out of service, constant", misprint="1C"),
    *_rows(
        MM2700,
        CONDENSED,
        """
        24-27 bad maintenance alarm
        2B bad process related
        3C-3F bad function check
        00 bad not specific
        73 uncertain simulated value, start
        78-7B uncertain process related
        88-8B good advisory alarm
        84 good update event
        C0 good
        23 bad passivated
        4B uncertain substitute set
        """,
    ),
    *_rows(
        LR260,
        CONDENSED,
        """
        00 bad not specific
        23 bad passivated
        24-27 bad maintenance alarm
        2B bad process related
        3C-3F bad function check
        80 good
        84-87 good update event
        89 good advisory alarm, low limit
        8A good advisory alarm, high limit
        8D good critical alarm, low limit
        8E good critical alarm, high limit
        4B uncertain substitute set
        4C-4F uncertain initial value
        """,
    ),
    *_rows(
        LR250,
        CONDENSED,
        """
        80 good
        84 good update event
        A0-A3 good initiate fail-safe
        A4-A7 good maintenance required
        A8-AB good maintenance demanded
        BC-BF good function check
        4F uncertain initial value
        68-6B uncertain maintenance demanded
        73 uncertain simulated value, start
        74-77 uncertain simulated value, end
        00 bad not specific
        23 bad passivated
        24-27 bad maintenance alarm
        3C-3F bad function check
        """,
    ),
    # LR260 of the same maker prints these three right
    Status(LR250, CONDENSED, "8A", "good", "advisory alarm", misprint="86"),
    Status(LR250, CONDENSED, "4B", "uncertain", "substitute set", misprint="45"),
    Status(LR250, CONDENSED, "2B", "bad", "process related", misprint="25"),
    *_rows(
        GA700,
        CONDENSED,
        """
        8D good critical alarm, low limit
        8E good critical alarm, high limit
        8F good critical alarm, constant
        89 good advisory alarm, low limit
        8A good advisory alarm, high limit
        8B good advisory alarm, constant
        BC good function check
        A8 good maintenance demanded
        A4 good maintenance required
        80 good
        68 uncertain maintenance demanded
        78 uncertain process related
        4F uncertain initial value, constant
        00 bad not specific
        3C bad function check
        3F bad function check, constant
        24 bad maintenance alarm
        27 bad maintenance alarm, constant
        """,
    ),
    *_rows(
        UFC400,
        CONDENSED,
        """
        00 bad not specific
        23 bad passivated
        24-27 bad maintenance alarm
        28-2B bad process related
        3C-3F bad function check
        48-4B uncertain substitute set
        4F uncertain initial value
        68-6B uncertain maintenance demanded
        73 uncertain simulated value, start
        77 uncertain simulated value, end
        78-7B uncertain process related
        """,
    ),
    *_rows(
        PROMAG500,
        CONDENSED,
        """
        24-27 bad maintenance alarm
        A8-AB good maintenance demanded
        80 good
        8E good critical alarm, high limit
        """,
    ),
    *_rows(
        TMT84,
        CONDENSED,
        """
        24 bad maintenance alarm
        A4 good maintenance required
        78 uncertain process related
        80 good
        """,
    ),
]


# --- DIAGNOSIS ------------------------------------------------------------------------------------------------------


class Diagnosis(NamedTuple):
    """DIAGNOSIS with one bit, and the words that its text has to have."""

    source: Source
    octets: str
    says: str


_CLASSIC_BITS: Final = (
    ("01 00 00 00", "electronics"),
    ("02 00 00 00", "mechanics"),
    ("04 00 00 00", "motor too hot"),
    ("08 00 00 00", "electronics too hot"),
    ("10 00 00 00", "memory error"),
    ("20 00 00 00", "measurement failed"),
    ("40 00 00 00", "not initialised"),
    ("80 00 00 00", "self-calibration failed"),
    ("00 01 00 00", "zero point error"),
    ("00 02 00 00", "supply failed"),
    ("00 04 00 00", "configuration not valid"),
    ("00 08 00 00", "warm start"),
    ("00 10 00 00", "cold start"),
    ("00 20 00 00", "maintenance required"),
    ("00 40 00 00", "characteristic not valid"),
    ("00 80 00 00", "ident number"),
    ("00 00 00 80", "DIAGNOSIS_EXTENSION"),
)
_CONDENSED_BITS: Final = (
    ("00 00 01 00", "maintenance alarm"),
    ("00 00 02 00", "maintenance demanded"),
    ("00 00 04 00", "function check"),
    ("00 00 08 00", "process conditions"),
)
#: Samson leaves two bits free
_NOT_SAMSON: Final = ("04 00 00 00", "00 02 00 00")

DIAGNOSES: Final = [
    *(Diagnosis(source, *row) for source in (POLYTRON, MFC300, LR250) for row in _CLASSIC_BITS),
    # this page has the second and the last octet
    *(Diagnosis(PROBE_LU, *row) for row in _CLASSIC_BITS[8:]),
    *(Diagnosis(SAMSON, *row) for row in (*_CLASSIC_BITS, *_CONDENSED_BITS) if row[0] not in _NOT_SAMSON),
    *(
        Diagnosis(source, *row)
        for source in (TRICOR, TMT84)
        for row in (*_CLASSIC_BITS[11:14], *_CONDENSED_BITS, _CLASSIC_BITS[-1])
    ),
    Diagnosis(TRICOR, "00 00 10 00", "parameters were changed"),
    Diagnosis(TMT84, "00 80 00 00", "ident number"),
]


class DiagBlock(NamedTuple):
    """A device related block of Slave_Diag with DIAGNOSIS: its octets, printed or after the printed table of bits."""

    source: Source
    octets: str
    says: tuple[str, ...]
    printed: bool


DIAG_BLOCKS: Final = [
    DiagBlock(TRANSMAG, "08 FE 01 01 20 00 00 80", ("slot 1", "a message appears", "measurement failed"), True),
    DiagBlock(TRANSMAG, "08 FE 01 01 30 00 00 80", ("memory error", "measurement failed"), True),
    DiagBlock(TRANSMAG, "08 FE 01 02 00 00 00 80", ("a message disappears",), True),
    DiagBlock(SAMSON, "14 FE 00 01 00 01 00 80 10" + 11 * " 00", ("zero point error", "maker's bit 5"), False),
    DiagBlock(F2D0, "09 FE 00 01 00 20 00 80 01", ("maintenance required", "maker's bit 1"), False),
]
