"""GSD files: lexer, parser, model, user parameters, configurations, diagnosis texts. Octets in, a model out.

- ``blocks``: What stands between an opening and a closing keyword, while it is read: one class for each kind of block
- ``check``: Findings on a whole GSD file: defaults against constants, slots nobody can plug, PROFIsafe
- ``configuration``: From modules in slots to the identifier octets of Chk_Cfg
- ``diag_blocks``: Blocks that hold texts of the diagnosis: areas, the types of DP-V1 blocks
- ``diag_texts``: Texts of the diagnosis from a GSD file, looked up by what a decoder has found
- ``dpv1_check``: What the DP-V1 keywords of a file contradict each other in, and how that is read
- ``findings``: Collects what is odd in a file. Noise has no end, the list has one
- ``identifiers``: Identifier octets of Chk_Cfg and Get_Cfg: the I/O configuration of a slave
- ``joining``: What was collected from a file becomes the model: parameters get their texts, references are checked
- ``keywords``: The keywords of the GSD specification (PNO order 2.122) in lower case
- ``lexer``: One logical line to one statement: ``keyword(index) = value``, comment taken off; and the values in it
- ``model``: What a GSD file says, as data. Nothing here reads or judges: :mod:`dpstack.gsd.parser` makes it
- ``module_block``: Modules and devices while they are read: identifier octets, user parameters, settings
- ``parser``: Reads a GSD file: octets in, a model and diagnostics out. Nothing in a file raises
- ``prm``: User parameters: from names and values to the octets of Set_Prm behind the seven fixed ones, and back
- ``settings``: From the settings of a file (``keyword = value``) to the fields of a device, each value judged once
- ``text``: From the octets of a file to its logical lines: decoding, line ends, continuations
"""
