"""Names of slaves and values for Sparkplug, OPC UA and Prometheus."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.bridge.names import (
    OPCUA_BROWSE,
    PROMETHEUS_LABEL,
    SPARKPLUG_ID,
    SPARKPLUG_METRIC,
    NameRule,
    unique_names,
)

RULES = [OPCUA_BROWSE, PROMETHEUS_LABEL, SPARKPLUG_ID, SPARKPLUG_METRIC]
_texts = st.one_of(st.sampled_from(["Pump", "pump", "pump 2", "a/b", "a+b", "a_b", "", " "]), st.text(max_size=8))
_given = st.dictionaries(st.sampled_from([str(address) for address in range(12)]), _texts)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.connector)
@given(given_names=_given)
def test_names_are_valid_different_and_independent_of_the_order(rule: NameRule, given_names: dict[str, str]) -> None:
    found = unique_names(rule, given_names.items())
    assert found == unique_names(rule, reversed(given_names.items()))
    names = list(found.names.values())
    assert found.names.keys() == given_names.keys()
    assert len({name.lower() for name in names} if rule.fold else set(names)) == len(names)
    for key, name in found.names.items():
        assert name == name.strip() != ""
        assert not set(name) & set(rule.reserved)
        assert len(name.encode()) <= rule.most
        assert "\0" not in name
        # the line has the key, by which a reader finds the slave
        assert name == given_names[key] or any(repr(name) in line and f"({key})" in line for line in found.changed)


def test_rules_one_by_one() -> None:
    assert SPARKPLUG_ID.valid("pump/1 #2+\x00\ud800") == "pump_1 _2___"
    assert SPARKPLUG_ID.valid("Förderband") == "Förderband"
    assert SPARKPLUG_ID.valid("e\u0301") == "\u00e9"
    assert SPARKPLUG_ID.valid("\u202e") == SPARKPLUG_ID.valid("") == "_"
    assert OPCUA_BROWSE.valid("1:level.raw") == "1_level_raw"
    assert len(SPARKPLUG_METRIC.valid("ä" * 500).encode()) == SPARKPLUG_METRIC.most


def test_the_lower_key_keeps_the_name() -> None:
    found = unique_names(SPARKPLUG_ID, [("10", "pump"), ("9", "Pump"), ("11", "pump 10")])
    assert found.names == {"9": "Pump", "10": "pump 10", "11": "pump 10 11"}
    assert found.changed == (
        "'pump' (10) is called 'pump 10': another one has this name",
        "'pump 10' (11) is called 'pump 10 11': another one has this name",
    )
