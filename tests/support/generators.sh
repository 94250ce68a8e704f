#!/usr/bin/env bash
# Two minutes of a hunt, and of tests that draw what they try: damaged, altered and hostile files and scenes, signals, and
# files that unpack to far more than they have, with a new seed. It exits with 1 if anything is found, printed with its
# seed. GitHub runs it every night, and `.ci/run` does not. CAROM_LONG=1 makes it hours: 100 kills, 60 scenes in both
# forms of kernels, half an hour of one run, a recording above 2^31 bytes.
set -uo pipefail
cd "$(dirname "$0")/../.."
seed=${CAROM_SEED:-$RANDOM$RANDOM}
limit=$(command -v timeout || true) # not on macOS
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
found=0

${limit:+$limit -k 10 300} carom hunt --budget 2min -o "$scratch/hunt" >"$scratch/hunt.log" 2>&1 &
hunt=$!

echo "CAROM_SEED=$seed"
CAROM_SEED=$seed ${limit:+$limit -s INT -k 10 70} pytest -n 0 -q --tb=short -m "slow or not slow" \
    tests/recording/read/test_corrupted.py tests/runs/test_altered_chunks.py
((code = $?, code == 0 || code == 2 || code == 124)) || found=1 # 2 and 124: the time was over
scenes=$(${limit:+$limit -k 10 40} python tests/support/hostile_scenes.py "$seed" 0 1000)
echo "$(grep -c '"faults"' <<<"$scenes") hostile scenes; repeat one with: python tests/support/hostile_scenes.py $seed INDEX 1"
if grep '"faults": \[[^]]' <<<"$scenes"; then found=1; fi

tries=("signals_everywhere.py $seed 20" "interrupted_programs.py $seed 8" "inflated_recordings.py $scratch state-"
    "inflated_data.py $scratch" "hostile_texts.py $seed 2" "endurance.py odd $seed 2")
if [ -n "${CAROM_LONG:-}" ]; then
    limit=
    tries+=("endurance.py kills $seed 100" "endurance.py forms $seed 60" "endurance.py soak $seed ${CAROM_SOAK:-1800}"
        "endurance.py large $seed 2147483649")
else
    tries+=("endurance.py kills $seed 10" "endurance.py soak $seed ${CAROM_SOAK:-60}") # plain kernels compile for minutes
fi
for each in "${tries[@]}"; do
    answers=$(${limit:+$limit -k 10 180} python tests/support/$each)
    code=$?
    ((code == 0 || code == 124)) && [ -n "$answers" ] || found=1
    echo "$(grep -c . <<<"$answers") attempts of: python tests/support/$each"
    if ((code == 1)); then grep -v '"faults": \[\]\|"wrong": ""' <<<"$answers"; fi
done

wait $hunt || found=1
cat "$scratch/hunt.log"
for scene in "$scratch"/hunt/*.toml; do
    if [ -f "$scene" ]; then cat "$scene"; fi
done
exit $found
