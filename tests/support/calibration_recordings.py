"""Real recordings on which calibrations are tested."""

from __future__ import annotations

RECORDINGS = {
    "V1_02": ("euroc/groundtruth/V1_02_asl.csv", "euroc/V1_02_estimate.txt"),
    "MH_01 OpenVINS": ("euroc/groundtruth/MH_01.txt", "euroc/openvins/MH_01_with_covariance.csv"),
    "MH_01 VINS-Mono": ("euroc/groundtruth/MH_01.txt", "euroc/vins_mono/MH_01.csv"),
    "MH_01 VIO": ("euroc/groundtruth/MH_01.txt", "euroc/vio_mono/MH_01.txt"),
    "MH_05 VIO": ("euroc/groundtruth/MH_05.txt", "euroc/vio_mono/MH_05.txt"),
    "V2_03 VIO": ("euroc/groundtruth/V2_03.txt", "euroc/vio_mono/V2_03.txt"),
    "fr2_desk": ("tum/fr2_desk_groundtruth.txt", "tum/fr2_desk_ORB.txt"),
}
