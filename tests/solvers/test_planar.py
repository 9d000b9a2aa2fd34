from __future__ import annotations

import torch

from fploc.solvers.planar import centroids, eigenvalues, mirrored, spread_ratios, symmetric_inverse


def symmetric(count: int) -> torch.Tensor:
    halves = torch.randn(count, 2, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return halves @ halves.mT


def test_inverse_is_that_of_torch() -> None:
    matrices = symmetric(20)
    torch.testing.assert_close(symmetric_inverse(matrices), torch.linalg.inv(matrices))


def test_eigenvalues_are_those_of_torch() -> None:
    matrices = symmetric(20)
    torch.testing.assert_close(torch.stack(eigenvalues(matrices), -1), torch.linalg.eigvalsh(matrices))


def test_centroid_is_that_of_the_heard_ones() -> None:
    access_points = torch.tensor([[0.0, 0.0], [4.0, 2.0], [100.0, 100.0]])
    heard = torch.tensor([[True, True, False], [False, False, False]])
    torch.testing.assert_close(centroids(access_points, heard), torch.tensor([[2.0, 1.0], [0.0, 0.0]]))


def test_spread_is_none_on_a_line_and_full_on_a_square() -> None:
    access_points = torch.tensor([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [0.0, 2.0], [2.0, 0.0]]).double()
    heard = torch.tensor([[True, True, True, False, False], [True, False, True, True, True]])
    torch.testing.assert_close(spread_ratios(access_points, heard), torch.tensor([0.0, 1.0]).double())


def test_mirror_keeps_ranges_to_access_points_on_a_line() -> None:
    access_points = torch.tensor([[0.0, 1.0], [3.0, 2.0], [6.0, 3.0]]).double()
    point = torch.tensor([[1.0, 5.0]]).double()
    image = mirrored(point, access_points, torch.ones(1, 3, dtype=torch.bool))
    assert torch.dist(image, point) > 1.0
    torch.testing.assert_close(torch.cdist(image, access_points), torch.cdist(point, access_points))
