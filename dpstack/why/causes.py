"""The fixed list of causes, each with its meaning, its evidence, and the next step; docs/how-to/why.md is made from
it."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class About(NamedTuple):
    """``meaning`` in a clause; ``told``: how it is recognised; ``next``: the next thing to try."""

    meaning: str
    told: str
    next: str


class Cause(Enum):
    """The causes; :attr:`word` is that of ``why --json``."""

    NOT_THERE = About(
        "nobody answers at the address: no power, a cut or swapped wire, another address, or deaf at this rate; these "
        "look the same on the wire",
        "Slave_Diag is not answered, other stations answer, no station with its ident was found",
        "look at the device: is its power on, does its bus LED light, are its address switches right? Then "
        "`dpstack scan` (does its ident appear at another address?), then measure A and B at its connector, then check "
        "that it knows this rate",
    )
    WRONG_ADDRESS = About(
        "the device has another address than the configuration says",
        "nobody, or another device, answers at the address, and a station with its ident answers at another one, where "
        "no such device is configured",
        "set the address switches of the device (or use `dpstack address`), or correct address in the configuration",
    )
    IDENT = About(
        "another device, or another edition of it, is at the address",
        "the ident number in its diagnosis is not the configured one",
        "compare the type plate with the configuration; name the GSD file of the device that is there",
    )
    MODULE_ORDER = About(
        "the modules are the right ones in another order",
        "Cfg_Fault, or Prm_Fault; Get_Cfg has the same identifiers in another order",
        "put `modules` into the order in which they are plugged, from the head station on",
    )
    MODULE_MISSING = About(
        "a module of the configuration is not in the station",
        "Cfg_Fault, or Prm_Fault; Get_Cfg lacks identifiers of the configuration",
        "plug the missing module (is it pushed in fully, does it have power?), or take it out of `modules`",
    )
    MODULE_EXTRA = About(
        "the station has a module that is not in the configuration",
        "Cfg_Fault, or Prm_Fault; Get_Cfg has identifiers that the configuration lacks",
        "add the module to `modules` at its place, or pull it",
    )
    MODULE_TYPE = About(
        "a module of another type is in a slot",
        "Cfg_Fault, or Prm_Fault; Get_Cfg has other identifiers in a slot",
        "compare the order numbers of the modules with `modules`, slot by slot",
    )
    TELEGRAM = About(
        "the drive is set to another telegram",
        "Cfg_Fault; Get_Cfg has the identifiers of another telegram of the drive",
        "name the telegram of the drive in the configuration (`telegram`), or set the drive to the configured one",
    )
    USER_PARAMETER = About(
        "the slave does not accept the value of a user parameter",
        "Prm_Fault after Set_Prm, with the right ident and the right number of octets",
        "compare the user parameters with the GSD file (`dpstack gsd show`); begin with its defaults and change one "
        "parameter after the other",
    )
    USER_PARAMETER_LENGTH = About(
        "the slave wants another number of octets of user parameters",
        "Prm_Fault or no answer to Set_Prm, and the GSD file gives another length",
        "let the GSD file make the parameters (`gsd`, `modules`, no `user_prm`); each module adds its own octets",
    )
    LOCKED = About(
        "another master has parameterised the slave and keeps it",
        "octet 4 of its diagnosis names another master",
        "stop the other master or take the slave out of its configuration; after a crash switch the slave off and on",
    )
    WATCHDOG_SHORT = About(
        "the watchdog of the slave is shorter than the time between two requests",
        "the slave leaves data exchange by itself and wants parameters, with its watchdog on; requests are further "
        "apart than its watchdog time",
        "raise watchdog_ms above the longest rotation of `dpstack plan`, or leave it out: the plan chooses then",
    )
    DUPLICATE_ADDRESS = About(
        "two stations have the address",
        "more answers than requests, nearly all answers unreadable, or answers of two different devices",
        "take one of the two off the bus and ask again: if somebody still answers, that is the second one",
    )
    NOISE_ON_STUB = About(
        "the connection of this slave is disturbed: loose contact, stub too long, shield, termination in its plug",
        "answers of this slave are damaged or missing now and then, those of the others are not",
        "look at its connector: A and B tight, shield on, termination switch off between two others; swap its cable",
    )
    NOISE_ON_SEGMENT = About(
        "the whole segment is disturbed: termination, shield, a cable beside a drive, too long for the rate",
        "answers of several slaves are damaged or missing now and then",
        "check that exactly both ends are terminated and have power; halve the segment and look which half is quiet",
    )
    ANSWERS_LATE = About(
        "the slave answers after the slot time",
        "its answers come, but when nobody waits for them any more",
        "raise t_sl (in [bus]) above its max_Tsdr at this rate (GSD file), or take the repeater's delay into account",
    )
    REBOOTS = About(
        "the slave restarts again and again",
        "it falls silent or refuses, and comes back without master and parameters",
        "measure its supply voltage while it runs (peaks of neighbours?), and look at its fault memory",
    )
    ALL_SILENT = About(
        "all slaves fell silent at once: what they share has failed",
        "no slave answers any more, and all of them did until the same moment",
        "look at all that the slaves share: the cable and the plug at the master, its adapter, their supply",
    )
    NOT_READY = About(
        "the slave has accepted everything, and its application does not get ready",
        "Station_Not_Ready stays set after Chk_Cfg",
        "look at the device: it may wait for modules, for its own start-up, or for a release",
    )
    STATIC_DIAGNOSIS = About(
        "the slave reports that it cannot give valid data",
        "Stat_Diag is set in its diagnosis",
        "look at its own fault display and at the extended diagnosis",
    )
    DATA_LENGTH = About(
        "the slave exchanges another number of octets than configured",
        "Data_Exchange brings another number of octets, or the slave refuses the outputs with Cfg_Fault",
        "compare the configuration with what Get_Cfg says, and both with the GSD file",
    )
    SERVICE_REFUSED = About(
        "the slave refuses a service of the bring-up",
        "RS, RR or UE as an answer to Slave_Diag, Set_Prm, Chk_Cfg or Data_Exchange",
        "RS: is it a DP slave at all? RR, UE: switch it off and on, and look at its fault display",
    )
    NOT_SUPPORTED = About(
        "the slave lacks a function that was asked for: SYNC, FREEZE or another one",
        "Not_Supported in its diagnosis after Set_Prm",
        "take sync and freeze out of its configuration",
    )
    ISOCHRONOUS = About(
        "the slave demands isochronous mode, whose clock telegram no port of a computer can keep",
        "its GSD file, a block of type 4 in Set_Prm, or IsoM_Req says so; the master refuses it with the lateness of "
        "this port",
        "give it to a master with isochronous mode, or take the demand out of its parameters, if it can work without",
    )
    MIN_TSDR = About(
        "the slave does not keep min T_SDR: it answers too early, or not at all after Set_Prm has set it",
        "its answers begin before min T_SDR; or it answers until Set_Prm, and not after it",
        "look for newer firmware of the device; a repeater between master and slave may shorten the pause, too",
    )
    DPV1_MISMATCH = About(
        "master and slave disagree about DP-V1",
        "Prm_Fault, and DPV1_Enable is set for a slave without DP-V1, or is missing although the slave needs it",
        "set dpv1 as the GSD file says: dpv1 = false for a slave without it",
    )
    ANOTHER_PROGRAM = About(
        "another program of this computer has the port open, too, or has changed its settings",
        "when slaves fell silent, the tty was set to another rate or frame, or another program had it open",
        "end that program, and keep it off the adapter: `dpstack doctor --port P` names it",
    )
    NO_TOKEN = About(
        "the master of the slave does not run, or does not get the token",
        "it is not in the ring, or holds no token; nobody asks the slave",
        "look at the list of masters: HSA of the other masters must be above this address; is the master running?",
    )
    SECOND_MASTER_SAME_ADDRESS = About(
        "another station sends with the address of this master",
        "telegrams from this master's own address that it has not sent",
        "give one of the two another address",
    )
    BUS_JAMMED = About(
        "a station sends without end, or noise covers everything",
        "octets come all the time that are no telegrams; the token gets lost, or cannot be taken",
        "take stations off the bus one after the other until it is quiet (begin with the last change)",
    )
    RATE_MISMATCH = About(
        "nobody answers at this rate",
        "no slave of the configuration answers, and no other station",
        "`dpstack baud --port P` listens for the rate; without a master try the rates that the GSD files have; then A "
        "and B swapped at the adapter, and its supply",
    )
    DEACTIVATED = About(
        "the application has taken the slave out of service",
        "deactivate() was called; nothing is sent to it",
        "activate() brings it back",
    )
    OWN_DIAGNOSIS = About(
        "the slave is in data exchange, and its own diagnosis reports a fault",
        "data exchange, and a diagnosis or alarm of a channel, a slot or the device",
        "look where the diagnosis says",
    )
    LINK_WITHOUT_DATA = About(
        "the slave is in data exchange, and data of a publisher do not come",
        "its link status message (or none) says so of a link that the configuration has (`subscribes`)",
        "ask why of the publisher; compare its number of inputs with the filter",
    )
    HEALTHY = About(
        "the slave is in data exchange, and nothing speaks against it",
        "data exchange with valid inputs, hardly a repetition, no loss",
        "nothing",
    )

    @property
    def about(self) -> About:
        """The texts of this cause."""
        return self.value

    @property
    def word(self) -> str:
        """``not_there``."""
        return self.name.lower()
