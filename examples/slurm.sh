#!/usr/bin/env bash
# warpsar on several GPUs of several hosts:   sbatch examples/slurm.sh learn scene.toml -o out
# One torchrun a host, one process a GPU. Folders must be seen by all hosts.
#SBATCH --job-name=warpsar
#SBATCH --nodes=2
#SBATCH --ntasks-per-node=1
#SBATCH --gpus-per-node=4
#SBATCH --cpus-per-task=32
#SBATCH --time=12:00:00
#SBATCH --signal=TERM@120
#SBATCH --requeue
set -euo pipefail

first=$(scontrol show hostnames "$SLURM_JOB_NODELIST" | sed -n 1p)
# A store of its own for every restart: restarts of one host are not counted by the others.
export TORCH_DISABLE_SHARE_RDZV_TCP_STORE=1
# Put back into the queue: go on from the checkpoint. (A batch of images makes what is missing by itself.)
case "$1" in
    learn | diagnose) if [ "${SLURM_RESTART_COUNT:-0}" -gt 0 ]; then set -- "$@" --resume; fi ;;
esac

srun torchrun \
    --nnodes "$SLURM_NNODES" --nproc-per-node "${SLURM_GPUS_ON_NODE:-1}" --max-restarts 3 \
    --rdzv-id "$SLURM_JOB_ID" --rdzv-backend c10d --rdzv-endpoint "$first:${WARPSAR_PORT:-29500}" \
    -m warpsar "$@"
