#!/bin/bash
# Make a reel of a long video with Slurm. Run this on the login node, with the arguments of `splatreel reconstruct`:
#
#     bash reel.sh CAPTURE --out OUT --width 1280
#
# CHAPTERS is the number of tasks of the array (20), and RESOURCES what each asks for; on GPUs add --gpus-per-task=1.
# `splatreel reconstruct ... --job chapter --estimate` says how much memory and time a task takes, and how many tasks are of use.
set -eu

run="splatreel reconstruct$(printf ' %q' "$@")"
read -ra resources <<< "${RESOURCES:---cpus-per-task=8 --mem=16G --time=12:00:00}"
after=(--kill-on-invalid-dep=yes)

scene=$(sbatch --parsable "${resources[@]}" --job-name=scene --wrap "$run --job scene")
chapters=$(sbatch --parsable "${resources[@]}" "${after[@]}" --dependency="afterok:$scene" --job-name=chapters \
    --array="0-$((${CHAPTERS:-20} - 1))" --wrap "$run --job chapter")
sbatch "${after[@]}" --dependency="afterany:$chapters" --cpus-per-task=2 --mem=8G --time=1:00:00 --job-name=finish \
    --wrap "$run --job finish"
