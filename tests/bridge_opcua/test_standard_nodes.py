"""The file of standard nodes against those that asyncua itself makes."""

from __future__ import annotations

import zlib

import pytest
from asyncua import ua
from asyncua.server.internal_server import InternalServer
from asyncua.ua.ua_binary import struct_to_binary

from dpstack.bridge.opcua.standard_nodes import FILE, add_standard_nodes
from tools import make_opcua_nodes


def octets_of(server: InternalServer) -> dict[str, tuple[dict[int, bytes], list[bytes]]]:
    """Attributes and references of all nodes as clients get them."""
    found = {}
    for id_, node in server.aspace._nodes.items():
        values = {int(key): struct_to_binary(one.value) for key, one in node.attributes.items()}
        found[id_.to_string()] = values, [struct_to_binary(one) for one in node.references]
    return found


def test_the_file_is_that_of_the_installed_asyncua() -> None:
    assert zlib.decompress(FILE.read_bytes()) == make_opcua_nodes.render(), "run python -m tools.make_opcua_nodes"


@pytest.mark.soak
async def test_clients_get_the_octets_of_the_nodes_that_asyncua_makes() -> None:
    ours, theirs = InternalServer(), InternalServer()
    await add_standard_nodes(ours.node_mgt_service)
    nodes, references = make_opcua_nodes.standard_nodes()
    list(theirs.node_mgt_service.try_add_nodes(nodes, check=False))
    list(theirs.node_mgt_service.try_add_references(references))
    found = octets_of(ours)
    assert found == octets_of(theirs)
    assert list(found) == [one.RequestedNewNodeId.to_string() for one in nodes]
    assert ua.NodeId(ua.ObjectIds.Server).to_string() in found
