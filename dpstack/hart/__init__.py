"""HART behind remote I/O: telegrams, commands in words, the records of a module; both ends without clock and bus.

- ``client``: The master's end of a module's HART records: directory, features, a request by Write, its answer by Read
- ``commands``: The data of HART commands 0 to 3, 11 to 16, 20, 48 decoded: identity, variables, tag, range, status
- ``module``: The module's end of HART records: channels with simulated transmitters, and their faults
- ``reading``: Identity, variables and status of a transmitter: several commands, as rows and as JSON
- ``records``: HART over PROFIBUS: request and response records, directory, features, errors of a module in words
- ``status``: Response code, device status and additional status (command 48) of a HART device in words
- ``tables``: Common tables of HART: engineering units, makers; packed ASCII, dates and Latin-1 texts
- ``telegram``: HART telegrams: delimiter, short and long address, command, data, check octet
- ``transmitter``: A simulated HART transmitter: its answers to universal commands
"""
