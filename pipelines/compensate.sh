#!/usr/bin/env bash
# Setpoints from live sensor lines. Copy it and put your own source and sink in:
# SOURCE prints the header and then one sensor line per sample, SINK reads one setpoint line each.
#
#   MODEL=model.json SOURCE="read_thermistors" SINK="write_offsets" ./compensate.sh
#
# The last line that SINK gets is the safe setpoint (zero), however the stream ends. The state is
# kept in CHECKPOINT: started again after a kill -9, the stream goes on where it was.
set -euo pipefail

MODEL=${MODEL:-model.json}
SOURCE=${SOURCE:-cat}
SINK=${SINK:-cat}
CHECKPOINT=${CHECKPOINT:-compensate.state.json}

bash -c "$SOURCE" |
  thermaltool compensate "$MODEL" --checkpoint "$CHECKPOINT" \
    --step "${STEP_UM:-0.5}" --slew "${SLEW_UM_PER_S:-10}" --limit "${LIMIT_UM:-:}" |
  bash -c "$SINK"
