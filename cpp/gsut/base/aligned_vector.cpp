// Huge pages for large arrays.
#include "gsut/base/aligned_vector.h"

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace gsut {

#if defined(__linux__)
void AdviseHugePages(void* begin, std::size_t bytes) {
  // The last, broken page stays as it is. Advice that is not taken costs time only.
  madvise(begin, bytes / kHugePageBytes * kHugePageBytes, MADV_HUGEPAGE);
}
#else
void AdviseHugePages(void*, std::size_t) {}
#endif

}  // namespace gsut
