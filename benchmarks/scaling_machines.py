"""Published machines for benchmarks/scaling_model.py: cores, memory, network, each with its source.

A core is taken to be as fast as the measured one as long as its share of the node's memory bandwidth allows.
"""

from scaling_model import Link, Machine

OLCF = (
    "OLCF, Frontier User Guide, docs.olcf.ornl.gov: 64 cores, 8 GPU dies, 4 NICs of 25 GB/s per node, 1.6 TB/s per die"
)
CSCS = (
    "CSCS, github.com/eth-cscs/cscs-reframe-tests, checks/microbenchmarks/mpi/osu (expected values on Alps, Slingshot 11): "
    "osu_latency of 256 bytes 2.3 us between hosts, 3.75 us between GPUs; osu_bw of 4 MiB 24 GB/s"
)
DDR4 = "eight channels of DDR4-3200, 205 GB/s at peak, of which STREAM gets 83 % on the two sockets of HBv3"
HBV3 = (
    "Microsoft, HBv3-series performance, learn.microsoft.com: 120 cores, HDR, 1.2 us (1 byte), 192 Gb/s (printed there as "
    "GB/s), STREAM triad 330-350 GB/s"
)
HBV4 = (
    "Microsoft, HBv4-series performance, learn.microsoft.com: NDR, less than 2 us (1 byte), 400 Gb/s, STREAM triad "
    "750-780 GB/s; 176 cores in the size HB176rs_v4"
)

FRONTIER = Machine("Slingshot 11 (Frontier, CPUs)", 64, 170e9, 4, Link(2.3e-6, 24e9), (OLCF, CSCS, DDR4))
HDR = Machine("HDR InfiniBand (HBv3)", 120, 340e9, 1, Link(1.2e-6, 24e9), (HBV3,))
NDR = Machine("NDR InfiniBand (HBv4)", 176, 765e9, 1, Link(2.0e-6, 50e9), (HBV4,))
# Half of the peak bandwidth: scattered sums, and kernels that are not written yet.
FRONTIER_GPUS = Machine("Slingshot 11 (Frontier, GPUs)", 8, 12.8e12, 4, Link(3.75e-6, 24e9), (OLCF, CSCS), share=0.5)

CPUS = (FRONTIER, HDR, NDR)
ALL = (*CPUS, FRONTIER_GPUS)
