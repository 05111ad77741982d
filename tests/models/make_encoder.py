"""Makes the ONNX files beside this file: a small encoder in the ways in which PyTorch exports models.

- `encoder.onnx` with `encoder.onnx.data`: today's default, weights in a second file
- `encoder-18.onnx`, `encoder-23.onnx`: the same exporter with these sets of operators, in one file
- `encoder-before.onnx`: the exporter before it, set 13

    pip install torch onnxscript
    python tests/models/make_encoder.py
"""

import sys
from pathlib import Path

import onnx
import torch
from torch import nn
from torch.nn import functional


class Encoder(nn.Module):
    """Three stages, a decoder, and what current networks are made of."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Sequential(nn.Conv2d(3, 16, 3, 2, 1), nn.BatchNorm2d(16), nn.SiLU())
        self.second = nn.Sequential(nn.Conv2d(16, 16, 3, 1, 1, groups=16), nn.GroupNorm(4, 16), nn.GELU())
        self.gate = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Conv2d(16, 16, 1), nn.Hardsigmoid())
        self.up = nn.ConvTranspose2d(16, 8, 2, 2)
        self.norm = nn.LayerNorm(16)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        x = self.first(image)
        x = self.second(functional.max_pool2d(x, 3, 2, 1, ceil_mode=True))
        x = x * self.gate(x)
        x = self.norm(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
        x = functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=True)
        x = functional.interpolate(self.up(x), scale_factor=0.5, mode="nearest")
        return functional.avg_pool2d(functional.celu(x, 1.5), 2, ceil_mode=True)


def export(name: str, **options: object) -> None:
    path = Path(__file__).with_name(name)
    torch.manual_seed(1)
    model = Encoder().eval()
    picture = torch.zeros(1, 3, 32, 64)
    names = {"input_names": ["image"], "output_names": ["features"]}
    torch.onnx.export(model, (picture,), str(path), **names, **options)
    # Where in which source file a node comes from is left out.
    exported = onnx.load(path, load_external_data=False)
    for part in [exported.graph, *exported.graph.node, *exported.graph.value_info]:
        del part.metadata_props[:]
        part.doc_string = ""
    onnx.save(exported, path)


if __name__ == "__main__":
    export("encoder.onnx")
    export("encoder-18.onnx", external_data=False, opset_version=18)
    export("encoder-23.onnx", external_data=False, opset_version=23)
    export("encoder-before.onnx", dynamo=False, opset_version=13)
