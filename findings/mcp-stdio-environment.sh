#!/bin/sh
# mcp 2.3.0 (the official Python package of the Model Context Protocol): the environment of a server that its client
# starts over standard input and output.
# Guess: the server has the environment of the client, as subprocess.Popen gives it; `env` replaces it, as there.
# It has six variables only (HOME, LOGNAME, PATH, SHELL, TERM, USER), and `env` is added to these. So XDG_RUNTIME_DIR, TMPDIR,
# LANG and VIRTUAL_ENV are missing: a server that finds other programs of the user by sockets in XDG_RUNTIME_DIR finds none.
# dpstack: `dpstack mcp` takes /run/user/UID if the variable is missing and the folder is the user's; the page of the set-up
# (docs/how-to/assistants.md) has `env` for all other cases.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install mcp==2.3.0 >/dev/null 2>&1
cat >"$dir/server.py" <<'PY'
import os

from mcp.server import MCPServer

server = MCPServer("environment")


@server.tool()
def names() -> list[str]:
    """The variables of the environment that the test has set."""
    wanted = "HOME LOGNAME PATH SHELL TERM USER LANG TMPDIR VIRTUAL_ENV XDG_RUNTIME_DIR MINE".split()
    return sorted(name for name in wanted if name in os.environ)


server.run()
PY
cat >"$dir/try.py" <<'PY'
import asyncio
import os
import subprocess
import sys

from mcp import ClientSession, StdioServerParameters, stdio_client

folder = os.path.dirname(os.path.abspath(__file__))
for name in "HOME LOGNAME PATH SHELL TERM USER LANG TMPDIR VIRTUAL_ENV XDG_RUNTIME_DIR".split():
    os.environ.setdefault(name, folder)


async def seen(env):
    server = StdioServerParameters(command=sys.executable, args=[f"{folder}/server.py"], env=env)
    async with stdio_client(server) as (reading, writing), ClientSession(reading, writing) as session:
        await session.initialize()
        return (await session.call_tool("names", {})).structured_content["result"]


print("env left out:", *(without := asyncio.run(seen(None))))
print("env={'MINE': ''}:", *(given := asyncio.run(seen({"MINE": ""}))))
word = "import os; print('XDG_RUNTIME_DIR' in os.environ)"
popen = subprocess.run([sys.executable, "-c", word], capture_output=True, text=True).stdout.strip()
print("subprocess has XDG_RUNTIME_DIR:", popen)
assert without == ["HOME", "LOGNAME", "PATH", "SHELL", "TERM", "USER"], "the behaviour has changed"
assert given == ["HOME", "LOGNAME", "MINE", "PATH", "SHELL", "TERM", "USER"], "the behaviour has changed"
assert popen == "True"
PY
"$dir/env/bin/python" "$dir/try.py"
# output seen:
# env left out: HOME LOGNAME PATH SHELL TERM USER
# env={'MINE': ''}: HOME LOGNAME MINE PATH SHELL TERM USER
# subprocess has XDG_RUNTIME_DIR: True
