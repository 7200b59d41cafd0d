"""The FC octets of requests, by hand; the frame count bits of those that have them are 0."""

from __future__ import annotations

from dpstack.fdl.telegram import Req

REQUEST_FCS = {
    Req.TIME_EVENT: 0x40,
    Req.SDA_LOW: 0x43,
    Req.SDN_LOW: 0x44,
    Req.SDA_HIGH: 0x45,
    Req.SDN_HIGH: 0x46,
    Req.MSRD: 0x47,
    Req.FDL_STATUS: 0x49,
    Req.SRD_LOW: 0x4C,
    Req.SRD_HIGH: 0x4D,
    Req.IDENT: 0x4E,
    Req.LSAP_STATUS: 0x4F,
    Req.CLOCK_VALUE: 0xC0,
}
