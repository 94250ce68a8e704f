#!/usr/bin/env bash
# Up to two minutes of the tests that draw what they try: damaged, altered and hostile files and scenes, with a new seed.
# What fails is printed with its seed, for a person to judge; .ci/run does not fail by it.
cd "$(dirname "$0")/../.."
seed=${CAROM_SEED:-$RANDOM$RANDOM}
limit=$(command -v timeout || true) # not on macOS

echo "CAROM_SEED=$seed"
CAROM_SEED=$seed ${limit:+$limit -s INT -k 10 70} pytest -n 0 -q --tb=short -m "slow or not slow" \
    tests/recording/read/test_corrupted.py tests/runs/test_altered_chunks.py
scenes=$(${limit:+$limit -k 10 40} python tests/support/hostile_scenes.py "$seed" 0 1000)
echo "$(grep -c '"faults"' <<<"$scenes") hostile scenes; repeat one with: python tests/support/hostile_scenes.py $seed INDEX 1"
grep '"faults": \[[^]]' <<<"$scenes" || echo "none with a fault"
