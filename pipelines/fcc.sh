#!/usr/bin/env bash
# A machine and its forecasting control in a closed loop through a named pipe. Copy it and put your
# own machine in: MACHINE prints a header and one line per sample, and takes one command line from
# the file "$COMMANDS" in answer to each. Here it is the simulated boring bar.
#
#   OUT=loop ./fcc.sh
#
# OUT/trial.csv   the piezo moved at random, free of the wall: what identifies the actuator
# OUT/cut.csv     the log of the machine in the loop
# OUT/fcc.log     what the control says
set -euo pipefail

export OUT=${OUT:-out} PART=${PART:-taper} DURATION=${DURATION:-4} SEED=${SEED:-1}
export COMMANDS=$OUT/commands
BAR='thermaltool plant boring-bar --part "$PART" --duration "$DURATION" --seed "$SEED" \
  --commands "$COMMANDS" -o "$OUT/cut.csv"'

mkdir -p "$OUT"
# Two seconds of random volts between 0 and 10, each held for 20 ms.
awk -v seed="$SEED" 'BEGIN {
  srand(seed); print "time_s,U_command_V"
  for (k = 0; k < 4000; k++) { if (k % 40 == 0) u = 10 * rand(); printf "%.4f,%.4f\n", k * 0.0005, u }
}' > "$OUT/volts.csv"
thermaltool plant boring-bar --part none --duration 2 --seed "$SEED" \
  --commands "$OUT/volts.csv" -o "$OUT/trial.csv"

rm -f "$COMMANDS"
mkfifo "$COMMANDS"
trap 'rm -f "$COMMANDS"' EXIT
# The machine ends first: then fcc has nobody to write to (141), which is its usual end here.
bash -c "${MACHINE:-$BAR}" |
  thermaltool fcc -C e_tool_um --period 0.0005 --identify "$OUT/trial.csv" --low-pass 753:0.707 \
    --spindle n_spindle_rpm --limit=-2:10 > "$COMMANDS" 2> "$OUT/fcc.log" ||
  [[ "${PIPESTATUS[*]}" == "0 141" ]]
