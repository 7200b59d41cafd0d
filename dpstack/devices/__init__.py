"""Device files: any device as a TOML file, on the bases PROFIdrive, DRIVECOM, bits, encoder, pa.

- ``pa/``: Device files of PROFIBUS PA devices: blocks in slots, their values with status, set points with status
- ``description``: The commissioning sheet of a device file
- ``drive_core``: Master side of a drive that a device file describes
- ``drive_device``: The simulated drive of a device file
- ``encoder``: A device file of an encoder as a profile: its scaling by the user parameters, and its named values
- ``encoder_core``: Master side of an encoder: the order that gives its position a value
- ``encoder_device``: The simulated encoder of a device file: it turns, answers presets, and has alarms to order
- ``encoder_examples``: The examples of an encoder's device file: octets received and their values, orders and the
  octets that they send
- ``encoder_reader``: Device files of encoders read and checked: position, velocity, preset, diagnosis
- ``examples``: The examples of a device file, carried out
- ``finding``: Drives by name or path: plugins of packages, and device files in folders
- ``keys``: The keys of a device file: names, types and limits
- ``machines``: State machines of simulated drives
- ``maps``: The maps of a device file: fields of the process data, and the parameters that say which
- ``model``: A device file as data
- ``profiles``: A device file as a drive profile
- ``reader``: Device files read and checked, every mistake by line
"""

from typing import TYPE_CHECKING, Final

from dpstack.namespaces import namespace

if TYPE_CHECKING:
    from dpstack.devices.drive_core import DeclaredCore as DeclaredCore
    from dpstack.devices.drive_core import FileCore as FileCore
    from dpstack.devices.drive_device import DeclaredDevice as DeclaredDevice
    from dpstack.devices.drive_device import FileDevice as FileDevice
    from dpstack.devices.finding import broken as broken
    from dpstack.devices.finding import find as find
    from dpstack.devices.finding import known as known
    from dpstack.devices.finding import known_devices as known_devices
    from dpstack.devices.profiles import DevicePython as DevicePython
    from dpstack.devices.reader import DeviceFileError as DeviceFileError

#: module and its public names
_PLACES: Final = """
drive_core DeclaredCore FileCore
drive_device DeclaredDevice FileDevice
finding broken find known known_devices
profiles DevicePython
reader DeviceFileError
"""
if not TYPE_CHECKING:  # a type checker knows the names
    __getattr__, __dir__, __all__ = namespace(__name__, _PLACES)
