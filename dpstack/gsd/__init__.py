"""GSD files: lexer, parser, model, user parameters, configurations, diagnosis texts.

Order of work: text, lexer, parser with blocks, joining with settings; the result is the model.

- ``blocks``: The block classes of the GSD parser: device, module, parameter, texts, slots and diagnosis while they
  are read
- ``check``: Checks of a whole GSD file: defaults against constants, slots without modules, PROFIsafe, missing modules
- ``configuration``: Configuration of a slave: from modules in slots to the identifier octets of Chk_Cfg, within all
  limits of the GSD
- ``device_comparison``: Comparison of two devices by their GSD files: the wire first, modules to choose from, texts,
  parameters, the rest
- ``diag_texts``: Look-up of the diagnosis texts of a GSD file by the octets and error types of a received diagnosis
- ``dpv1_keywords``: The DP-V1 keywords of a GSD file
- ``identifiers``: Identifier octets of Chk_Cfg and Get_Cfg: parser of the I/O configuration of a slave, general and
  special format
- ``joining``: Builds the model (Device) from the parsed blocks: gives parameters their texts and checks the
  references
- ``lexer``: Lexer of GSD files: one logical line to one statement, ``keyword(index) = value`` without comment, and
  its values
- ``model``: Data model of a GSD file: device, modules, slots, user parameters, diagnosis texts, diagnostics of the
  file
- ``module_comparison``: Comparison of the configuration that Chk_Cfg asks for with the slave's own one, module by
  module
- ``module_readings``: Readings of identifier octets: rows of modules of a GSD file that give the configuration that a
  slave has
- ``parser``: Parser of GSD files: octets in, the model and diagnostics out
- ``prm``: User parameters (User_Prm_Data): from names and values to octets of Set_Prm behind the seven fixed ones,
  and back
- ``search``: Search in GSD files by words: ident number, order number, model, vendor, names of modules, name of the
  file
- ``settings``: From the settings of a GSD file (``keyword = value``) to the fields of Device, DpV1 and Isochronous
- ``text``: From the octets of a file to its logical lines: decoding, line ends, continuations
"""

from typing import TYPE_CHECKING, Final

from dpstack.namespaces import namespace

if TYPE_CHECKING:
    from dpstack.gsd.check import check as check
    from dpstack.gsd.configuration import Configuration as Configuration
    from dpstack.gsd.configuration import configuration_like as configuration_like
    from dpstack.gsd.configuration import configure as configure
    from dpstack.gsd.configuration import plug as plug
    from dpstack.gsd.dpv1_keywords import DpV1 as DpV1
    from dpstack.gsd.identifiers import Identifier as Identifier
    from dpstack.gsd.identifiers import io_lengths as io_lengths
    from dpstack.gsd.identifiers import parse_identifiers as parse_identifiers
    from dpstack.gsd.model import Device as Device
    from dpstack.gsd.model import Diagnostic as Diagnostic
    from dpstack.gsd.model import DiagText as DiagText
    from dpstack.gsd.model import GsdFile as GsdFile
    from dpstack.gsd.model import Module as Module
    from dpstack.gsd.model import Parameter as Parameter
    from dpstack.gsd.model import Slot as Slot
    from dpstack.gsd.model import Speed as Speed
    from dpstack.gsd.parser import load_gsd as load_gsd
    from dpstack.gsd.parser import parse_gsd as parse_gsd
    from dpstack.gsd.prm import Reading as Reading
    from dpstack.gsd.prm import UserPrm as UserPrm

#: module and its public names
_PLACES: Final = """
check check
configuration Configuration configuration_like configure plug
identifiers Identifier io_lengths parse_identifiers
dpv1_keywords DpV1
model Device DiagText Diagnostic GsdFile Module Parameter Slot Speed
parser load_gsd parse_gsd
prm Reading UserPrm
"""
if not TYPE_CHECKING:  # a type checker knows the names
    __getattr__, __dir__, __all__ = namespace(__name__, _PLACES)
