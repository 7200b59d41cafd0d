"""``dpstack web``: the page in the browser."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path

from dpstack.api.commissioning.commissioning import Commissioning
from dpstack.api.config.config import load_config
from dpstack.cli import options
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.nonblocking_stdout import run_unhurried
from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal
from dpstack.errors import UsageError
from dpstack.tcp_address import Listen, is_local
from dpstack.web import PAGE
from dpstack.web.rights import make_rights, read_tokens, tls_context, who_may
from dpstack.web.run_source import RunSource
from dpstack.web.source import ReplaySource, Source


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "example: dpstack web plant.toml\n"
        "         dpstack web plant.toml --control\n"
        "         dpstack web plant.toml --listen 192.168.1.5:8470 --token tokens --control --tls cert.pem key.pem"
    )
    parser.value("config", "CONFIG", "configuration file", nargs="?", type=Path)
    parser.value("--listen", "HOST:PORT", f"the address of the page (default {PAGE})", default=PAGE)
    parser.flag("--control", "orders may be given on the page; without a run, one can be started there")
    parser.flag("--read-only", "no orders may be given on the page (the default)")
    parser.value("--token", "FILE", "only for those with a token of this file, lines NAME TOKEN, mode 0600", type=Path)
    parser.value("--tls", ("CERT", "KEY"), "serve over TLS, with a certificate and key (PEM files)", nargs=2, type=Path)
    parser.value("--replay", "FILE", "show a recording in place of a bus", type=Path)
    parser.value("--gsd", "DIR", "folder of GSD files for commissioning (default: that of CONFIG)", type=Path)
    parser.value("--join", "NAME", "join a running program by its name for `dpstack ctl`, without CONFIG")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 0 at Ctrl-C or SIGTERM."""
    options.require("aiohttp", "dpstack web", "web")
    source, config = _source(args)
    commissioning = Commissioning(config, args.gsd)
    listen = Listen.parse(args.listen)
    tokens = None if args.token is None else read_tokens(args.token)
    context, names = tls_context(*args.tls) if args.tls else (None, frozenset())
    sockets = listen.sockets()
    try:
        local = is_local(sockets)
        rights = make_rights(local=local, control=args.control, tokens=tokens, tls=context is not None)
    except BaseException:
        for one in sockets:
            one.close()
        raise

    async def run() -> int:
        from dpstack.web.web_server import serve

        with StopSignal() as stop:
            async with serve(
                source,
                listen,
                rights=rights,
                log=output.warn,
                tls=context,
                names=names,
                sockets=sockets,
                commissioning=commissioning,
            ) as server:
                if args.json:
                    output.json_line({"event": "listening", "url": server.url})
                else:
                    output.line(f"the page is at {server.url}")
                    output.line(who_may(rights, tls=context is not None, local=local))
                output.flush()
                await stop.or_done(asyncio.Event().wait())
        return INTERRUPTED if stop.hurried else 0

    return run_unhurried(run(), json=args.json)


def _source(args: argparse.Namespace) -> tuple[Source, Path | None]:
    """The source, and the path of the configuration if there is one."""
    if args.read_only and args.control:
        raise UsageError("web: --control gives orders and --read-only forbids them: leave one out")
    if args.replay is not None:
        if args.join is not None or args.control:
            raise UsageError("web: --replay shows a recording in place of a bus: leave out --join and --control")
        return ReplaySource(args.replay), args.config
    if (args.config is None) == (args.join is None):
        raise UsageError("web: give the configuration file, for instance dpstack web plant.toml, or --join NAME")
    if args.join is not None:
        return RunSource.named(args.join), None
    config = load_config(args.config)
    return RunSource.of(config, control=args.control), args.config
