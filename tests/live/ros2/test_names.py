"""Tokens and addresses of ROS 2 over Zenoh, against examples and definitions of `rmw_zenoh_cpp`."""

import pytest

from skyherd.errors import InputError
from skyherd.live.ros2.camera_info import camera_info_topic
from skyherd.live.ros2.names import Place, Quality, Topic, announced_topic, split_address

IMAGES = Topic("left/image", "sensor_msgs/msg/Image", "RIHS01_0123")


@pytest.mark.parametrize(
    ("quality", "text"),
    [
        (Quality(10), "::,10:,:,:,,"),
        (Quality(42), "::,:,:,:,,"),
        (Quality(5, reliable=False), "2::,5:,:,:,,"),
    ],
)
def test_quality_leaves_out_defaults_of_rmw_zenoh(quality, text) -> None:
    assert quality.text == text


def test_token_of_subscription_is_read_back() -> None:
    token = IMAGES.token(Place(domain=3, node="eyes"), "ab12", 4, "MS", Quality(10))
    assert token == (
        "@ros2_lv/3/ab12/0/4/MS/%/%/eyes/%left%image/sensor_msgs::msg::dds_::Image_/RIHS01_0123/::,10:,:,:,,"
    )
    assert announced_topic(token) == ("MS", "left/image", "sensor_msgs/msg/Image")
    assert announced_topic("@ros2_lv/3/ab12/0/0/NN/%/%/eyes") is None


def test_address_gives_place_topic_and_options() -> None:
    given = "ros2://[::1]:7448/a/b?domain=9&node=eyes&config=z.json5&type=Image"
    place, name, options = split_address(given, "camera", options=("type",), node="other")
    assert place == Place("::1", 7448, 9, "eyes", "z.json5")
    assert (name, options) == ("a/b", {"type": "Image"})


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("ros2://h/a?domain=233", "domain '233'; ROS_DOMAIN_ID, 0 to 232"),
        ("ros2://h/a?type=Image", "option 'type'; of domain, node, config"),
        ("ros2://h/a//b", "letters, digits and _ between slashes"),
        ("ros2://h/a*", "letters, digits and _ between slashes"),
    ],
)
def test_invalid_address_is_one_line(address, said) -> None:
    with pytest.raises(InputError, match=r"^camera: ") as error:
        split_address(address, "camera", node="eyes")
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("images", "info"),
    [
        ("camera/image_raw", "camera/camera_info"),
        ("camera/image_raw/compressed", "camera/camera_info"),
        ("image", "camera_info"),
    ],
)
def test_camera_info_lies_beside_the_images(images, info) -> None:
    assert camera_info_topic(images) == info
