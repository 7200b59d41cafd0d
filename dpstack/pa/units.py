"""Unit codes of PROFIBUS PA, from the parameter's number to symbol and name, and back.

Codes 1000 to 1999 are the profile's, 32768 to 65535 the maker's. Sources, and the points on which they disagree:
docs/reference/decisions/pa.md#unit-codes.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

#: the unit stands as text in a further parameter of the block, for instance OUT_UNIT_TEXT
TEXTUAL: Final = 1995
#: the value has no unit
NONE: Final = 1997
#: reserved for makers in the profile's range: Emerson has Nm³ at 1521, others something else
_OWN_IN_PROFILE: Final = range(1521, 1551)
_OWN: Final = range(32768, 65536)
#: codes without a unit of their own, and those that every 16 bit enumeration of the profile has
_WORDS: Final[Mapping[int, str]] = {
    TEXTUAL: "unit as text",
    1996: "unit not used",
    NONE: "",
    1998: "unit unknown",
    1999: "special unit",
    65530: "unit not used",
    65531: "",
    65532: "unit unknown",
    65533: "special unit",
}


class Unit(NamedTuple):
    """A unit of the profile. ``symbol``: for display, for instance ``m³/h``; ``name``: ``cubic metre per hour``."""

    code: int
    symbol: str
    name: str


def unit_name(code: int) -> str:
    """The unit for display beside a value: the symbol; empty for 1997 (none); words for a code without a symbol.

    Any number is possible: a code that no table has, or a maker's, is shown as a number.
    """
    unit = units().get(code)
    if unit is not None:
        return unit.symbol
    if code in _WORDS:
        return _WORDS[code]
    return f"maker's unit {code}" if code in _OWN or code in _OWN_IN_PROFILE else f"unit {code}"


def find_unit(text: str) -> int | None:
    """The code of the unit that somebody typed: its symbol, its name, or the number itself; None if none is meant.

    ASCII is enough: ``m3/h``, ``uS/cm``, ``degC``, ``l/s``, ``Ohm``. Of two codes with one symbol the usual one counts.
    """
    text = text.strip()
    if text.isascii() and text.isdigit():
        code = int(text[:6])
        return code if code <= 0xFFFF else None
    return _by_text().get(_plain(text)) or _by_text().get(text.lower())


@functools.cache
def units() -> Mapping[int, Unit]:
    """Every unit of the profile that has a symbol, by its code."""
    rows = (line.partition(" | ") for line in _TABLE.strip().splitlines())
    return MappingProxyType({(unit := _unit(head, name)).code: unit for head, _, name in rows})


def _unit(head: str, name: str) -> Unit:
    code, _, symbol = head.partition(" ")
    return Unit(int(code), symbol, name)


#: the value of acidity, not the picohenry
_PREFERRED: Final = (1422,)


@functools.cache
def _by_text() -> Mapping[str, int]:
    table: dict[str, int] = {}
    for code in (*_PREFERRED, *units()):
        unit = units()[code]
        table.setdefault(_plain(unit.symbol), code)
        table.setdefault(unit.name.lower(), code)
    return table


_SPELLED: Final = str.maketrans(
    {"²": "2", "³": "3", "µ": "u", "μ": "u", "Ω": "Ohm", "°": "deg", "·": None, "*": None, " ": None}
)
_LITRE: Final = re.compile(r"(?<![A-Za-z])([NSumchkM]?)l(?![A-Za-z])")


def _plain(text: str) -> str:
    """A symbol as it is typed in ASCII."""
    return _LITRE.sub(r"\1L", text.translate(_SPELLED))


#: code, symbol | name
_TABLE: Final = """
1000 K | kelvin
1001 °C | degree Celsius
1002 °F | degree Fahrenheit
1003 °R | degree Rankine
1004 rad | radian
1005 ° | degree (angle)
1006 ' | minute of arc
1007 " | second of arc
1008 gon | gon
1009 r | revolution
1010 m | metre
1011 km | kilometre
1012 cm | centimetre
1013 mm | millimetre
1014 µm | micrometre
1015 nm | nanometre
1016 pm | picometre
1017 Å | angstrom
1018 ft | foot
1019 in | inch
1020 yd | yard
1021 mile | mile
1022 nautical mile | nautical mile
1023 m² | square metre
1024 km² | square kilometre
1025 cm² | square centimetre
1026 dm² | square decimetre
1027 mm² | square millimetre
1028 a | are
1029 ha | hectare
1030 in² | square inch
1031 ft² | square foot
1032 yd² | square yard
1033 mile² | square mile
1034 m³ | cubic metre
1035 dm³ | cubic decimetre
1036 cm³ | cubic centimetre
1037 mm³ | cubic millimetre
1038 L | litre
1039 cL | centilitre
1040 mL | millilitre
1041 hL | hectolitre
1042 in³ | cubic inch
1043 ft³ | cubic foot
1044 yd³ | cubic yard
1045 mile³ | cubic mile
1046 pint | US liquid pint
1047 quart | US liquid quart
1048 gal | US gallon
1049 ImpGal | imperial gallon
1050 bushel | US dry bushel
1051 bbl | barrel (US petroleum, 42 gal)
1052 bbl (liq) | barrel (US liquid, 31.5 gal)
1053 SCF | standard cubic foot
1054 s | second
1055 ks | kilosecond
1056 ms | millisecond
1057 µs | microsecond
1058 min | minute
1059 h | hour
1060 d | day
1061 m/s | metre per second
1062 mm/s | millimetre per second
1063 m/h | metre per hour
1064 km/h | kilometre per hour
1065 knot | knot
1066 in/s | inch per second
1067 ft/s | foot per second
1068 yd/s | yard per second
1069 in/min | inch per minute
1070 ft/min | foot per minute
1071 yd/min | yard per minute
1072 in/h | inch per hour
1073 ft/h | foot per hour
1074 yd/h | yard per hour
1075 mi/h | mile per hour
1076 m/s² | metre per second squared
1077 Hz | hertz
1078 THz | terahertz
1079 GHz | gigahertz
1080 MHz | megahertz
1081 kHz | kilohertz
1082 1/s | per second
1083 1/min | per minute
1084 r/s | revolution per second
1085 rpm | revolution per minute
1086 rad/s | radian per second
1087 1/s² | per second squared
1088 kg | kilogram
1089 g | gram
1090 mg | milligram
1091 Mg | megagram
1092 t | metric ton
1093 oz | ounce
1094 lb | pound
1095 STon | short ton
1096 LTon | long ton
1097 kg/m³ | kilogram per cubic metre
1098 Mg/m³ | megagram per cubic metre
1099 kg/dm³ | kilogram per cubic decimetre
1100 g/cm³ | gram per cubic centimetre
1101 g/m³ | gram per cubic metre
1102 t/m³ | metric ton per cubic metre
1103 kg/L | kilogram per litre
1104 g/mL | gram per millilitre
1105 g/L | gram per litre
1106 lb/in³ | pound per cubic inch
1107 lb/ft³ | pound per cubic foot
1108 lb/gal | pound per gallon (US)
1109 STon/yd³ | short ton per cubic yard
1110 °Tw | degree Twaddell
1111 °Bé (heavy) | degree Baumé, heavy
1112 °Bé (light) | degree Baumé, light
1113 °API | degree API
1114 SGU | specific gravity
1115 kg/m | kilogram per metre
1116 mg/m | milligram per metre
1117 tex | tex
1118 kg·m² | kilogram square metre
1119 kg·m/s | kilogram metre per second
1120 N | newton
1121 MN | meganewton
1122 kN | kilonewton
1123 mN | millinewton
1124 µN | micronewton
1125 kg·m²/s | kilogram square metre per second
1126 N·m | newton metre
1127 MN·m | meganewton metre
1128 kN·m | kilonewton metre
1129 mN·m | millinewton metre
1130 Pa | pascal
1131 GPa | gigapascal
1132 MPa | megapascal
1133 kPa | kilopascal
1134 mPa | millipascal
1135 µPa | micropascal
1136 hPa | hectopascal
1137 bar | bar
1138 mbar | millibar
1139 torr | torr
1140 atm | atmosphere
1141 psi | pound-force per square inch
1142 psia | pound-force per square inch, absolute
1143 psig | pound-force per square inch, gauge
1144 gf/cm² | gram-force per square centimetre
1145 kgf/cm² | kilogram-force per square centimetre
1146 inH2O | inch of water
1147 inH2O (4 °C) | inch of water at 4 °C
1148 inH2O (68 °F) | inch of water at 68 °F
1149 mmH2O | millimetre of water
1150 mmH2O (4 °C) | millimetre of water at 4 °C
1151 mmH2O (68 °F) | millimetre of water at 68 °F
1152 ftH2O | foot of water
1153 ftH2O (4 °C) | foot of water at 4 °C
1154 ftH2O (68 °F) | foot of water at 68 °F
1155 inHg | inch of mercury
1156 inHg (0 °C) | inch of mercury at 0 °C
1157 mmHg | millimetre of mercury
1158 mmHg (0 °C) | millimetre of mercury at 0 °C
1159 Pa·s | pascal second
1160 m²/s | square metre per second
1161 P | poise
1162 cP | centipoise
1163 St | stokes
1164 cSt | centistokes
1165 N/m | newton per metre
1166 mN/m | millinewton per metre
1167 J | joule
1168 EJ | exajoule
1169 PJ | petajoule
1170 TJ | terajoule
1171 GJ | gigajoule
1172 MJ | megajoule
1173 kJ | kilojoule
1174 mJ | millijoule
1175 Wh | watt hour
1176 TWh | terawatt hour
1177 GWh | gigawatt hour
1178 MWh | megawatt hour
1179 kWh | kilowatt hour
1180 cal | calorie
1181 kcal | kilocalorie
1182 Mcal | megacalorie
1183 Btu | British thermal unit
1184 datherm | dekatherm
1185 ft·lbf | foot pound-force
1186 W | watt
1187 TW | terawatt
1188 GW | gigawatt
1189 MW | megawatt
1190 kW | kilowatt
1191 mW | milliwatt
1192 µW | microwatt
1193 nW | nanowatt
1194 pW | picowatt
1195 Mcal/h | megacalorie per hour
1196 MJ/h | megajoule per hour
1197 Btu/h | British thermal unit per hour
1198 hp | horsepower (electric)
1199 W/(m·K) | watt per metre kelvin
1200 W/(m²·K) | watt per square metre kelvin
1201 m²·K/W | square metre kelvin per watt
1202 J/K | joule per kelvin
1203 kJ/K | kilojoule per kelvin
1204 J/(kg·K) | joule per kilogram kelvin
1205 kJ/(kg·K) | kilojoule per kilogram kelvin
1206 J/kg | joule per kilogram
1207 MJ/kg | megajoule per kilogram
1208 kJ/kg | kilojoule per kilogram
1209 A | ampere
1210 kA | kiloampere
1211 mA | milliampere
1212 µA | microampere
1213 nA | nanoampere
1214 pA | picoampere
1215 C | coulomb
1216 MC | megacoulomb
1217 kC | kilocoulomb
1218 µC | microcoulomb
1219 nC | nanocoulomb
1220 pC | picocoulomb
1221 Ah | ampere hour
1222 C/m³ | coulomb per cubic metre
1223 C/mm³ | coulomb per cubic millimetre
1224 C/cm³ | coulomb per cubic centimetre
1225 kC/m³ | kilocoulomb per cubic metre
1226 mC/m³ | millicoulomb per cubic metre
1227 µC/m³ | microcoulomb per cubic metre
1228 C/m² | coulomb per square metre
1229 C/mm² | coulomb per square millimetre
1230 C/cm² | coulomb per square centimetre
1231 kC/m² | kilocoulomb per square metre
1232 mC/m² | millicoulomb per square metre
1233 µC/m² | microcoulomb per square metre
1234 V/m | volt per metre
1235 MV/m | megavolt per metre
1236 kV/m | kilovolt per metre
1237 V/cm | volt per centimetre
1238 mV/m | millivolt per metre
1239 µV/m | microvolt per metre
1240 V | volt
1241 MV | megavolt
1242 kV | kilovolt
1243 mV | millivolt
1244 µV | microvolt
1245 F | farad
1246 mF | millifarad
1247 µF | microfarad
1248 nF | nanofarad
1249 pF | picofarad
1250 F/m | farad per metre
1251 µF/m | microfarad per metre
1252 nF/m | nanofarad per metre
1253 pF/m | picofarad per metre
1254 C·m | coulomb metre
1255 A/m² | ampere per square metre
1256 MA/m² | megaampere per square metre
1257 A/cm² | ampere per square centimetre
1258 kA/m² | kiloampere per square metre
1259 A/m | ampere per metre
1260 kA/m | kiloampere per metre
1261 A/cm | ampere per centimetre
1262 T | tesla
1263 mT | millitesla
1264 µT | microtesla
1265 nT | nanotesla
1266 Wb | weber
1267 mWb | milliweber
1268 Wb/m | weber per metre
1269 kWb/m | kiloweber per metre
1270 H | henry
1271 mH | millihenry
1272 µH | microhenry
1273 nH | nanohenry
1274 pH | picohenry
1275 H/m | henry per metre
1276 µH/m | microhenry per metre
1277 nH/m | nanohenry per metre
1278 A·m² | ampere square metre
1279 N·m²/A | newton square metre per ampere
1280 Wb·m | weber metre
1281 Ω | ohm
1282 GΩ | gigaohm
1283 MΩ | megohm
1284 kΩ | kilohm
1285 mΩ | milliohm
1286 µΩ | microohm
1287 S | siemens
1288 kS | kilosiemens
1289 mS | millisiemens
1290 µS | microsiemens
1291 Ω·m | ohm metre
1292 GΩ·m | gigaohm metre
1293 MΩ·m | megohm metre
1294 kΩ·m | kilohm metre
1295 Ω·cm | ohm centimetre
1296 mΩ·m | milliohm metre
1297 µΩ·m | microohm metre
1298 nΩ·m | nanoohm metre
1299 S/m | siemens per metre
1300 MS/m | megasiemens per metre
1301 kS/m | kilosiemens per metre
1302 mS/cm | millisiemens per centimetre
1303 µS/mm | microsiemens per millimetre
1304 1/H | per henry
1305 sr | steradian
1306 W/sr | watt per steradian
1307 W/(sr·m²) | watt per steradian square metre
1308 W/m² | watt per square metre
1309 lm | lumen
1310 lm·s | lumen second
1311 lm·h | lumen hour
1312 lm/m² | lumen per square metre
1313 lm/W | lumen per watt
1314 lx | lux
1315 lx·s | lux second
1316 cd | candela
1317 cd/m² | candela per square metre
1318 g/s | gram per second
1319 g/min | gram per minute
1320 g/h | gram per hour
1321 g/d | gram per day
1322 kg/s | kilogram per second
1323 kg/min | kilogram per minute
1324 kg/h | kilogram per hour
1325 kg/d | kilogram per day
1326 t/s | metric ton per second
1327 t/min | metric ton per minute
1328 t/h | metric ton per hour
1329 t/d | metric ton per day
1330 lb/s | pound per second
1331 lb/min | pound per minute
1332 lb/h | pound per hour
1333 lb/d | pound per day
1334 STon/s | short ton per second
1335 STon/min | short ton per minute
1336 STon/h | short ton per hour
1337 STon/d | short ton per day
1338 LTon/s | long ton per second
1339 LTon/min | long ton per minute
1340 LTon/h | long ton per hour
1341 LTon/d | long ton per day
1342 % | percent
1343 % sol/wt | percent solid per weight
1344 % sol/vol | percent solid per volume
1345 % steam quality | percent steam quality
1346 °Plato | degree Plato
1347 m³/s | cubic metre per second
1348 m³/min | cubic metre per minute
1349 m³/h | cubic metre per hour
1350 m³/d | cubic metre per day
1351 L/s | litre per second
1352 L/min | litre per minute
1353 L/h | litre per hour
1354 L/d | litre per day
1355 ML/d | megalitre per day
1356 ft³/s | cubic foot per second
1357 ft³/min | cubic foot per minute
1358 ft³/h | cubic foot per hour
1359 ft³/d | cubic foot per day
1360 SCF/min | standard cubic foot per minute
1361 SCF/h | standard cubic foot per hour
1362 gal/s | gallon (US) per second
1363 gal/min | gallon (US) per minute
1364 gal/h | gallon (US) per hour
1365 gal/d | gallon (US) per day
1366 Mgal/d | megagallon (US) per day
1367 ImpGal/s | gallon (imperial) per second
1368 ImpGal/min | gallon (imperial) per minute
1369 ImpGal/h | gallon (imperial) per hour
1370 ImpGal/d | gallon (imperial) per day
1371 bbl/s | barrel per second
1372 bbl/min | barrel per minute
1373 bbl/h | barrel per hour
1374 bbl/d | barrel per day
1375 W/m² | watt per square metre
1376 mW/m² | milliwatt per square metre
1377 µW/m² | microwatt per square metre
1378 pW/m² | picowatt per square metre
1379 Pa·s/m³ | pascal second per cubic metre
1380 N·s/m | newton second per metre
1381 Pa·s/m | pascal second per metre
1382 B | bel
1383 dB | decibel
1384 mol | mole
1385 kmol | kilomole
1386 mmol | millimole
1387 µmol | micromole
1388 kg/mol | kilogram per mole
1389 g/mol | gram per mole
1390 m³/mol | cubic metre per mole
1391 dm³/mol | cubic decimetre per mole
1392 cm³/mol | cubic centimetre per mole
1393 L/mol | litre per mole
1394 J/mol | joule per mole
1395 kJ/mol | kilojoule per mole
1396 J/(mol·K) | joule per mole kelvin
1397 mol/m³ | mole per cubic metre
1398 mol/dm³ | mole per cubic decimetre
1399 mol/L | mole per litre
1400 mol/kg | mole per kilogram
1401 mmol/kg | millimole per kilogram
1402 Bq | becquerel
1403 MBq | megabecquerel
1404 kBq | kilobecquerel
1405 Bq/kg | becquerel per kilogram
1406 kBq/kg | kilobecquerel per kilogram
1407 MBq/kg | megabecquerel per kilogram
1408 Gy | gray
1409 mGy | milligray
1410 rd | rad (dose)
1411 Sv | sievert
1412 mSv | millisievert
1413 rem | rem
1414 C/kg | coulomb per kilogram
1415 mC/kg | millicoulomb per kilogram
1416 R | roentgen
1417 1/(J·m³) | per joule and cubic metre
1418 e/(V·m³) | elementary charge per volt and cubic metre
1419 m³/C | cubic metre per coulomb
1420 V/K | volt per kelvin
1421 mV/K | millivolt per kelvin
1422 pH | pH value
1423 ppm | parts per million
1424 ppb | parts per billion
1425 ppth | parts per thousand
1426 °Brix | degree Brix
1427 °Ball | degree Balling
1428 proof/vol | proof per volume
1429 proof/mass | proof per mass
1430 lb/ImpGal | pound per gallon (imperial)
1431 kcal/s | kilocalorie per second
1432 kcal/min | kilocalorie per minute
1433 kcal/h | kilocalorie per hour
1434 kcal/d | kilocalorie per day
1435 Mcal/s | megacalorie per second
1436 Mcal/min | megacalorie per minute
1437 Mcal/d | megacalorie per day
1438 kJ/s | kilojoule per second
1439 kJ/min | kilojoule per minute
1440 kJ/h | kilojoule per hour
1441 kJ/d | kilojoule per day
1442 MJ/s | megajoule per second
1443 MJ/min | megajoule per minute
1444 MJ/d | megajoule per day
1445 Btu/s | British thermal unit per second
1446 Btu/min | British thermal unit per minute
1447 Btu/d | British thermal unit per day
1448 µgal/s | microgallon (US) per second
1449 mgal/s | milligallon (US) per second
1450 kgal/s | kilogallon (US) per second
1451 Mgal/s | megagallon (US) per second
1452 µgal/min | microgallon (US) per minute
1453 mgal/min | milligallon (US) per minute
1454 kgal/min | kilogallon (US) per minute
1455 Mgal/min | megagallon (US) per minute
1456 µgal/h | microgallon (US) per hour
1457 mgal/h | milligallon (US) per hour
1458 kgal/h | kilogallon (US) per hour
1459 Mgal/h | megagallon (US) per hour
1460 µgal/d | microgallon (US) per day
1461 mgal/d | milligallon (US) per day
1462 kgal/d | kilogallon (US) per day
1463 µImpGal/s | microgallon (imperial) per second
1464 mImpGal/s | milligallon (imperial) per second
1465 kImpGal/s | kilogallon (imperial) per second
1466 MImpGal/s | megagallon (imperial) per second
1467 µImpGal/min | microgallon (imperial) per minute
1468 mImpGal/min | milligallon (imperial) per minute
1469 kImpGal/min | kilogallon (imperial) per minute
1470 MImpGal/min | megagallon (imperial) per minute
1471 µImpGal/h | microgallon (imperial) per hour
1472 mImpGal/h | milligallon (imperial) per hour
1473 kImpGal/h | kilogallon (imperial) per hour
1474 MImpGal/h | megagallon (imperial) per hour
1475 µImpGal/d | microgallon (imperial) per day
1476 mImpGal/d | milligallon (imperial) per day
1477 kImpGal/d | kilogallon (imperial) per day
1478 MImpGal/d | megagallon (imperial) per day
1479 µbbl/s | microbarrel per second
1480 mbbl/s | millibarrel per second
1481 kbbl/s | kilobarrel per second
1482 Mbbl/s | megabarrel per second
1483 µbbl/min | microbarrel per minute
1484 mbbl/min | millibarrel per minute
1485 kbbl/min | kilobarrel per minute
1486 Mbbl/min | megabarrel per minute
1487 µbbl/h | microbarrel per hour
1488 mbbl/h | millibarrel per hour
1489 kbbl/h | kilobarrel per hour
1490 Mbbl/h | megabarrel per hour
1491 µbbl/d | microbarrel per day
1492 mbbl/d | millibarrel per day
1493 kbbl/d | kilobarrel per day
1494 Mbbl/d | megabarrel per day
1495 µm³/s | cubic micrometre per second
1496 mm³/s | cubic millimetre per second
1497 km³/s | cubic kilometre per second
1498 Mm³/s | cubic megametre per second
1499 µm³/min | cubic micrometre per minute
1500 mm³/min | cubic millimetre per minute
1501 km³/min | cubic kilometre per minute
1502 Mm³/min | cubic megametre per minute
1503 µm³/h | cubic micrometre per hour
1504 mm³/h | cubic millimetre per hour
1505 km³/h | cubic kilometre per hour
1506 Mm³/h | cubic megametre per hour
1507 µm³/d | cubic micrometre per day
1508 mm³/d | cubic millimetre per day
1509 km³/d | cubic kilometre per day
1510 Mm³/d | cubic megametre per day
1511 cm³/s | cubic centimetre per second
1512 cm³/min | cubic centimetre per minute
1513 cm³/h | cubic centimetre per hour
1514 cm³/d | cubic centimetre per day
1515 kcal/kg | kilocalorie per kilogram
1516 Btu/lb | British thermal unit per pound
1517 kL | kilolitre
1518 kL/min | kilolitre per minute
1519 kL/h | kilolitre per hour
1520 kL/d | kilolitre per day
1551 S/cm | siemens per centimetre
1552 µS/cm | microsiemens per centimetre
1553 mS/m | millisiemens per metre
1554 µS/m | microsiemens per metre
1555 MΩ·cm | megohm centimetre
1556 kΩ·cm | kilohm centimetre
1557 % wt | percent by weight
1558 mg/L | milligram per litre
1559 µg/L | microgram per litre
1560 % sat | percent of saturation
1561 vpm | volume parts per million
1562 % vol | percent by volume
1563 mL/min | millilitre per minute
1564 mg/dm³ | milligram per cubic decimetre
1565 mg/L | milligram per litre (for new designs: 1558)
1566 mg/m³ | milligram per cubic metre
1567 ct | carat
1568 lb (troy) | troy pound
1569 oz (troy) | troy ounce
1570 fl oz | US fluid ounce
1571 cm³ | cubic centimetre (for new designs: 1036)
1572 af | acre foot
1573 Nm³ | normal cubic metre (0 °C, 1013.25 hPa)
1574 NL | normal litre (0 °C, 1013.25 hPa)
1575 Sm³ | standard cubic metre (20 °C, 1013.25 hPa)
1576 SL | standard litre (20 °C, 1013.25 hPa)
1577 mL/s | millilitre per second
1578 mL/h | millilitre per hour
1579 mL/d | millilitre per day
1580 af/s | acre foot per second
1581 af/min | acre foot per minute
1582 af/h | acre foot per hour
1583 af/d | acre foot per day
1584 fl oz/s | US fluid ounce per second
1585 fl oz/min | US fluid ounce per minute
1586 fl oz/h | US fluid ounce per hour
1587 fl oz/d | US fluid ounce per day
1588 Nm³/s | normal cubic metre per second (0 °C, 1013.25 hPa)
1589 Nm³/min | normal cubic metre per minute (0 °C, 1013.25 hPa)
1590 Nm³/h | normal cubic metre per hour (0 °C, 1013.25 hPa)
1591 Nm³/d | normal cubic metre per day (0 °C, 1013.25 hPa)
1592 NL/s | normal litre per second (0 °C, 1013.25 hPa)
1593 NL/min | normal litre per minute (0 °C, 1013.25 hPa)
1594 NL/h | normal litre per hour (0 °C, 1013.25 hPa)
1595 NL/d | normal litre per day (0 °C, 1013.25 hPa)
1596 Sm³/s | standard cubic metre per second (20 °C, 1013.25 hPa)
1597 Sm³/min | standard cubic metre per minute (20 °C, 1013.25 hPa)
1598 Sm³/h | standard cubic metre per hour (20 °C, 1013.25 hPa)
1599 Sm³/d | standard cubic metre per day (20 °C, 1013.25 hPa)
1600 SL/s | standard litre per second (20 °C, 1013.25 hPa)
1601 SL/min | standard litre per minute (20 °C, 1013.25 hPa)
1602 SL/h | standard litre per hour (20 °C, 1013.25 hPa)
1603 SL/d | standard litre per day (20 °C, 1013.25 hPa)
1604 SCF/s | standard cubic foot per second
1605 SCF/d | standard cubic foot per day
1606 oz/s | ounce per second
1607 oz/min | ounce per minute
1608 oz/h | ounce per hour
1609 oz/d | ounce per day
1610 Pa a | pascal, absolute
1611 Pa g | pascal, gauge
1612 GPa a | gigapascal, absolute
1613 GPa g | gigapascal, gauge
1614 MPa a | megapascal, absolute
1615 MPa g | megapascal, gauge
1616 kPa a | kilopascal, absolute
1617 kPa g | kilopascal, gauge
1618 mPa a | millipascal, absolute
1619 mPa g | millipascal, gauge
1620 µPa a | micropascal, absolute
1621 µPa g | micropascal, gauge
1622 hPa a | hectopascal, absolute
1623 hPa g | hectopascal, gauge
1624 gf/cm² a | gram-force per square centimetre, absolute
1625 gf/cm² g | gram-force per square centimetre, gauge
1626 kgf/cm² a | kilogram-force per square centimetre, absolute
1627 kgf/cm² g | kilogram-force per square centimetre, gauge
1628 SD 4 °C | standard density at 4 °C
1629 SD 15 °C | standard density at 15 °C
1630 SD 20 °C | standard density at 20 °C
1631 PS | metric horsepower
1632 ppt | parts per trillion
1633 hL/s | hectolitre per second
1634 hL/min | hectolitre per minute
1635 hL/h | hectolitre per hour
1636 hL/d | hectolitre per day
1637 bbl (liq)/s | barrel (US liquid) per second
1638 bbl (liq)/min | barrel (US liquid) per minute
1639 bbl (liq)/h | barrel (US liquid) per hour
1640 bbl (liq)/d | barrel (US liquid) per day
1641 bbl (fed) | barrel (US federal, 31 gal)
1642 bbl (fed)/s | barrel (US federal) per second
1643 bbl (fed)/min | barrel (US federal) per minute
1644 bbl (fed)/h | barrel (US federal) per hour
1645 bbl (fed)/d | barrel (US federal) per day
"""
