#!/bin/sh
# A line of ptys, slaves with faults on it, and the tests of the application: sh job.sh
# Ends with 1 if a test or a step of the scenario failed. Leaves junit.xml, sim.jsonl and sim.txt beside this file.
set -eu
cd "$(dirname "$0")"
line="$(mktemp -d)/line"
sim=
dpstack segment --stations 2 --dir "$line" > segment.txt 2>&1 &
segment=$!
trap 'kill $sim $segment 2> /dev/null || true; wait' EXIT

until_there() { # FILE
    for _ in $(seq 100); do
        if [ -e "$1" ]; then return; fi
        sleep 0.1
    done
    echo "$1 did not appear within 10 s" >&2
    cat segment.txt >&2
    exit 1
}

until_there "$line/1"
dpstack sim plant.toml --port "$line/0" --scenario faults.toml --log sim.jsonl > sim.txt 2>&1 &
sim=$!
PLANT_PORT="$line/1" python -m pytest test_plant.py --junitxml=junit.xml -o junit_suite_name=plant
kill -TERM $sim
wait $sim # 1 if a step of the scenario failed
sim=
