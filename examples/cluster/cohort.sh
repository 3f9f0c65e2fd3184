#!/bin/sh
# Fits a cohort by a Slurm array: sh cohort.sh SUBJECTS.tsv OUT [SHARDS]. Prints the array's number. After a failure,
# submit the same command again: existing models are kept. TASKS=3,7 submits only these shards.
#
# A task that is stopped (preempted, or near its time limit) has 60 s to write finished models, and is queued again.
set -eu
manifest=$1 out=$2 shards=${3:-10}
degree=${DEGREE:-80} cpus=${CPUS:-2} more=${MORE:-}
mkdir -p "$out/log"

sbatch --parsable --array="${TASKS:-0-$((shards - 1))}" --cpus-per-task="$cpus" --requeue --open-mode=append \
  --signal=B:TERM@60 --job-name=cohort --output="$out/log/%a.out" <<END
#!/bin/sh
# The shell passes the signal on and waits; 75 says that the same command goes on where it ended.
trap 'kill -TERM \$!; wait \$!; test \$? = 75 && scontrol requeue "\$SLURM_JOB_ID"; exit 75' TERM
spharm fit --manifest "$manifest" --max-degree $degree --output "$out" --shard \$SLURM_ARRAY_TASK_ID/$shards \
  --keep-going --skip-existing --status "$out/status/\$SLURM_ARRAY_TASK_ID.tsv" $more &
wait \$!
END
