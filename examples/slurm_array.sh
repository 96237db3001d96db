#!/bin/bash
#SBATCH --job-name=synthgen
#SBATCH --array=1-64
#SBATCH --cpus-per-task=16
#SBATCH --mem-per-cpu=2G
#SBATCH --time=08:00:00
#SBATCH --requeue
#
# One slice of a dataset per task of an array, into one folder that all of them see:
#
#   JOB=paper OUT=/data/paper sbatch examples/slurm_array.sh
#
# Submit it again until `synthgen status $OUT` says complete: what is done is not done again, and a
# task that Slurm ends loses no more than the subjects it was at.
set -eu
exec synthgen render "$JOB" --out "$OUT" \
  --shard "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT" \
  --workers "$SLURM_CPUS_PER_TASK"
