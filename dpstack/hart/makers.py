"""Manufacturer identification codes of HART (Common Table 8), as far as public sources have them.

Source: docs/reference/decisions/hart.md. The codes 1 to 166 of HART 5; later ones have the same meaning in two octets.
"""

from __future__ import annotations

from typing import Final

#: by code, from 1 on
_MAKERS: Final = """\
Acromag,Allen Bradley,Ametek,Analog Devices,Elsag Bailey,Beckman,Bell Microsensor,Bourns,Bristol Babcock,
Brooks Instrument,Chessell,Combustion Engineering,Daniel Industries,Delta,Dieterich Standard,Dohrmann,
Endress+Hauser,Elsag Bailey,Fisher Controls,Foxboro,Fuji,ABB,Honeywell,ITT Barton,Kay Ray/Sensall,ABB,
Leeds & Northrup,Leslie,M-System,Measurex,Micro Motion,Moore Industries,Moore Products,Ohkura Electric,Paine,
Rochester Instrument Systems,Ronan,Rosemount,Peek Measurement,Schlumberger,Sensall,Siemens,Weed,Toshiba,
Transmation,Rosemount Analytic,Metso,Flowserve,Varec,Viatran,Delta/Weed,Westinghouse,Xomox,Yamatake,Yokogawa,
Nuovo Pignone,Promac,Exac,Mobrey,Arcom,Princo,Smar,Foxboro Eckardt,Measurement Technology,
Applied System Technologies,Samson,Sparling,Fireye,Krohne,Betz,Druck,SOR,Elcon,EMCO,Termiflex,VAF Instruments,
Westlock Controls,Drexelbrook,Saab Tank Control,K-TEK,Flowdata,Draeger,Raytek,Siemens Milltronics,BTG,Magnetrol,
Metso,Milltronics,Helios,Anderson Instrument,INOR,Robertshaw,Pepperl+Fuchs,Accutech,Flow Measurement,Kamstrup,
Knick,VEGA,MTS Systems,Oval,Masoneilan-Dresser,Besta,Ohmart,Harold Beck and Sons,Rittmeyer,Rossel Messtechnik,WIKA,
Bopp & Reuther Heinrichs,PR electronics,Jordan Controls,Valcom,US Electric Motors,Apparatebau Hundsbach,Dynisco,
Spriano,Direct Measurement,Klay Instruments,Action Instruments,MMG,Buerkert,Aaliant,Pondus,ZAP,GLI,
Fisher-Rosemount Performance Technologies,Paper Machine Components,LABOM,Danfoss,Turbo,Tokyo Keiso,SMC,
Status Instruments,Huakong,Duon System,Vortek Instruments,AG Crosby,Action Instruments,Keystone Controls,
Thermo Electric,ISE-Magtech,Rueger,Mettler Toledo,Det-Tronics,TN Technologies,DeZurik,Phase Dynamics,
Welltech Shanghai,Enraf,4tech,Brandt Instruments,Nivelco,Camille Bauer,Metran,Milton Roy,PMV,Turck,Panametrics,
Stahl,Analytical Technology,Fieldbus International,Berthold,InterCorr,China Briconte,Electron Machine,
Sierra Instruments,Fluid Components"""
_NAMES: Final = tuple(_MAKERS.replace("\n", "").split(","))


def maker_text(code: int) -> str:
    """The name of the maker and its ``code`` (0..65535), or "unknown" and the code."""
    number = f"0x{code:02X}" if code < 0x100 else f"0x{code:04X}"
    return f"{_NAMES[code - 1]} ({number})" if 1 <= code <= len(_NAMES) else f"unknown ({number})"
