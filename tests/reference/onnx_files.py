"""Small ONNX networks with the names of inputs and outputs of the public files."""

import onnx
from onnx import TensorProto, helper, numpy_helper


def save_network(path, inputs, outputs, nodes, constants=None):
    """Write a network: shapes of inputs and outputs by name, nodes (kind, in, out, attributes)."""
    made = [helper.make_node(kind, i, o, **attributes) for kind, i, o, attributes in nodes]
    kinds = {"num_tokens": TensorProto.INT64}

    def tensors(shapes):
        return [
            helper.make_tensor_value_info(name, kinds.get(name, TensorProto.FLOAT), shape)
            for name, shape in shapes.items()
        ]

    held = [numpy_helper.from_array(array, name) for name, array in (constants or {}).items()]
    graph = helper.make_graph(made, "small", tensors(inputs), tensors(outputs), held)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, str(path))
    return path
